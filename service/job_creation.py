"""Create jobs: check the request, quotas and disk space; return the earlier job for a repeated key."""

from collections.abc import Sequence
from hashlib import sha256
from typing import Any

from fastapi import Response

from dynamictree.errors import InputError
from dynamictree.photo_requests import PHOTOS_OF_VIDEO, PhotoParams
from dynamictree.plant.choice import MOST_LISTED, matching
from dynamictree.requests import AnimateParams, CloudParams, Format
from jobs.clients.usage import count_jobs
from jobs.clients.webhooks import endpoint
from jobs.errors import ConflictError
from jobs.lifecycle.maintenance import is_served
from jobs.records import AssetRecord, ClientKey, JobRecord, Json
from jobs.states import AUTO, CPU, GPU, JobState, JobType, queue_of, stages_of
from jobs.storage.assets import read_asset
from jobs.store import new_id
from service.http.problems import ProblemError, wrong_field
from service.http.routing import is_id
from service.job_responses import job_payload
from service.routes.catalogue import preset_sizes
from service.schemas.jobs import JobPayload, JobRequest
from service.services import Owned
from service.uploads.quota import require_room, require_space

KEY_EXPIRES_S = 86400.0
COPIED_FIELDS = ("type", "preset", "seed", "priority", "webhook_events", "external_id", "metadata", "destination")
"""Fields that a job copies from its request."""

PAPER = "paper"
"""The preset that takes minutes without a GPU."""


def add_job(
    owned: Owned, body: JobRequest, request_id: str | None, response: Response, *, key: str | None
) -> JobPayload:
    """Validate a request and store its job, or return the job created with the same key."""
    named = None
    if key is not None:
        named = ClientKey(key=key, body_sha256=_fingerprint(body), expires_s=KEY_EXPIRES_S)
        earlier = owned.store.job_of_key(named)  # checked first: the asset may be gone by now, or the queue full
        if earlier is not None:
            return _answer(owned, earlier, response)
    asset, stages = _require_possible(owned, body)
    job = _record(
        owned,
        request_id=request_id,
        asset_id=asset.id,
        params=_resolved(body, asset),
        queue=queue_of(_queue(owned, body, asset), body.priority),
        webhook_id=body.webhook,
        cancel_at=None if body.cancel_after_s is None else owned.store.clock() + body.cancel_after_s,
        **{name: getattr(body, name) for name in COPIED_FIELDS},
    )
    return _store(owned, job, stages, named, response)


def add_retry(owned: Owned, old: JobRecord, request_id: str | None, response: Response) -> JobPayload:
    """Store a new job with the request of a job that has ended."""
    if not old.terminal:
        raise ConflictError(f"job {old.id} is {old.state}; only one that has ended can be run again")
    _require_turn(owned)
    require_space(owned, 0)
    asset_id = read_asset(owned.store, old.asset_id).id
    own = {name: getattr(old, name) for name in (*COPIED_FIELDS, "params", "queue", "webhook_id")}
    again = _record(owned, request_id=request_id, asset_id=asset_id, retry_of=old.id, **own)
    return _store(owned, again, tuple(stage.name for stage in old.stages), None, response)


def _store(
    owned: Owned, job: JobRecord, stages: tuple[JobType, ...], key: ClientKey | None, response: Response
) -> JobPayload:
    most = owned.caller.limits.get("active_jobs")
    return _answer(owned, owned.store.add_job(job, stages=stages, client_key=key, max_active=most)[0], response)


def _answer(owned: Owned, stored: JobRecord, response: Response) -> JobPayload:
    response.headers["Location"] = f"/v1/jobs/{stored.id}"
    return job_payload(owned, stored, response)


def _fingerprint(body: JobRequest) -> str:
    """Hash only the fields that were sent, since defaults change with releases."""
    return sha256(body.model_dump_json(exclude_unset=True).encode()).hexdigest()


def _require_possible(owned: Owned, body: JobRequest) -> tuple[AssetRecord, tuple[JobType, ...]]:
    """Return the asset and stages of a request, or refuse it."""
    _require_turn(owned)
    require_room(owned)
    if not is_id(body.asset_id):
        raise ProblemError("not-found", f"there is no asset {body.asset_id!r}; POST /v1/assets gives ids")
    if body.priority == "high" and "high-priority" not in owned.caller.scopes:
        raise ProblemError("forbidden", "this key may not ask for high priority; leave it at normal")
    if body.webhook is not None:
        endpoint(owned.store, body.webhook)
    if body.destination is not None:
        _require_destination(owned, body.destination)
    asset = read_asset(owned.store, body.asset_id)
    stages = stages_of(body.type, asset.kind)
    if "diffuse" in stages and body.preset not in preset_sizes():
        detail = f"there is no preset {body.preset!r}; there are {', '.join(preset_sizes()) or 'none'}"
        raise wrong_field("/preset", "unknown-preset", detail)
    chosen = [name for name in CloudParams.model_fields if name != "box_m" and getattr(body.params, name) is not None]
    if chosen and asset.kind == "photos":
        detail = f"asset {asset.id} is of kind photos, in which no part has a place or name yet"
        raise wrong_field(f"/params/{chosen[0]}", "not-allowed", detail)
    _require_photos(body, asset)
    frames, wanted = asset.summary.get("film_frames"), body.params.video_frames or PHOTOS_OF_VIDEO
    if isinstance(frames, int) and frames < wanted:
        detail = f"the film has {frames} frames, {wanted} are to be chosen; film a slow walk around the tree"
        raise wrong_field("/params/video_frames", "not-allowed", detail)
    if body.params.tree is not None:
        _require_tree(body.params.tree, asset)
    for option in ("still", "moving"):
        _require_parts(option, getattr(body.params, option) or (), asset)
    require_space(owned, _product_bytes(body, asset))
    return asset, stages


def _require_destination(owned: Owned, wanted: str) -> None:
    owner, prefixes = owned.caller.owner or "", owned.services.settings.destinations
    allowed = [prefix.replace("{owner}", owner).rstrip("/") + "/" for prefix in prefixes]
    below = wanted.startswith(tuple(allowed)) and wanted.isprintable()
    if not below or {*"%?#", ".."} & {*wanted, *wanted.split("/")}:  # object stores resolve these to another path
        raise ProblemError("forbidden", f"{wanted!r} is not below one of {allowed}, or has one of % ? # ..")


def _require_photos(body: JobRequest, asset: AssetRecord) -> None:
    """Refuse options of photos and films for other assets, whose size is the upload's."""
    names = body.params.model_fields_set & PhotoParams.model_fields.keys()
    chosen = sorted(name for name in names if getattr(body.params, name) != PhotoParams.model_fields[name].default)
    if chosen and asset.kind != "photos":
        detail = (
            f"asset {asset.id} is of kind {asset.kind}; {chosen[0]} is allowed with photos or a film only; "
            "choose the parts of a mesh or cloud that move by box_m, still, moving or tree, its size when you upload it"
        )
        raise wrong_field(f"/params/{chosen[0]}", "not-allowed", detail)


def _require_tree(number: int, asset: AssetRecord) -> None:
    trees = asset.summary.get("trees")
    if not isinstance(trees, list):
        detail = f"asset {asset.id} is of kind {asset.kind}; trees are separated in meshes, splats and scans"
        raise wrong_field("/params/tree", "not-allowed", detail)
    if number > len(trees):
        raise wrong_field("/params/tree", "out-of-range", f"asset {asset.id} holds {len(trees)} trees, not {number}")


def _require_parts(option: str, patterns: Sequence[str], asset: AssetRecord) -> None:
    """Refuse a name that no part has; a worker refuses patterns, and names of parts that the summary does not list."""
    listed, still = asset.summary.get("part_names"), asset.summary.get("still_parts")
    names = listed.split(", ") if isinstance(listed, str) else []
    if asset.kind == "cloud" and isinstance(still, list):
        names = [str(part["name"]) for part in still if isinstance(part, dict)]
    elif not 0 < len(names) < MOST_LISTED:
        return
    try:
        matching(option, [name for name in patterns if not {*"*?[,"} & {*name}], names)
    except InputError as error:
        raise wrong_field(f"/params/{option}", "not-allowed", str(error)) from None


def _record(owned: Owned, **fields: Any) -> JobRecord:
    return JobRecord(id=new_id(), state=JobState.QUEUED, created_at=owned.store.clock(), **fields)


def _queue(owned: Owned, body: JobRequest, asset: AssetRecord) -> str:
    """Choose a job's queue: GPU if it has workers and the job benefits from one, or no CPU worker is running."""
    if owned.services.settings.queue != AUTO:
        return owned.services.settings.queue
    learns = asset.kind == "photos" or (body.type in ("diffuse", "animate") and body.preset == PAPER)
    return GPU if is_served(owned.store, GPU) and (learns or not is_served(owned.store, CPU)) else CPU


def _require_turn(owned: Owned) -> None:
    most = owned.services.settings.max_queued_jobs
    if count_jobs(owned.services.store, [JobState.QUEUED]) >= most:
        raise ProblemError("queue-full", f"{most} jobs wait already, which is the limit")


def _resolved(body: JobRequest, asset: AssetRecord) -> dict[str, Json]:
    """Return the job's parameters for the worker; fill in default formats, and always add a PNG."""
    params: dict[str, Json] = body.params.model_dump(mode="json")
    for name in CloudParams.model_fields:
        if params[name] is None:
            del params[name]
    if isinstance(body.params, AnimateParams):
        params["formats"] = list(_formats(body.params, asset))
        params["period_s"] = body.params.period_s or body.params.wanted_period_s
    return params


def _formats(params: AnimateParams, asset: AssetRecord) -> tuple[Format, ...]:
    return tuple(dict.fromkeys((*params.chosen_formats(cloud=asset.kind == "cloud"), "png")))


def _product_bytes(body: JobRequest, asset: AssetRecord) -> int:
    """Return the total size of the products whose size is known in advance [bytes].

    Raises:
        InputError: the frames are no loop, a format does not support turbulent motion, a file would be too large, or a
            format's library is not installed.
    """
    if not isinstance(body.params, AnimateParams):
        return 0
    # these modules import numba, so they are imported at the first request
    from dynamictree.export.size import min_sequence_bytes
    from dynamictree.export.table import require_available
    from dynamictree.modal.real_trees import loop_period_s

    height_m = asset.summary.get("height_m")
    of_height_s = loop_period_s(height_m if isinstance(height_m, float) else 0.0)
    period_s = body.params.period_s or body.params.wanted_period_s or of_height_s
    formats, num_frames = _formats(body.params, asset), body.params.count_frames(period_s)
    require_available(formats)
    mesh = _counts(asset, "mesh", "num_vertices", "num_faces")
    cloud = _counts(asset, "cloud", "num_gaussians", "sh_degree")
    return sum(min_sequence_bytes(formats, num_frames, body.params, mesh=mesh, cloud=cloud).values())


def _counts(asset: AssetRecord, kind: str, first: str, second: str) -> tuple[int, int]:
    """Return two counts of an asset of this kind; 0 for other kinds, and if an earlier release did not count."""
    if asset.kind != kind:
        return 0, 0
    one, other = asset.summary.get(first, 0), asset.summary.get(second, 0)
    assert isinstance(one, int)
    assert isinstance(other, int)
    return one, other
