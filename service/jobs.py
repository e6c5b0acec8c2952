"""/v1/jobs: ask for a product, look how far it is, stop it, run it again, list what it made."""

from collections.abc import Callable
from hashlib import sha256
from statistics import median
from typing import Annotated, TypeVar

from fastapi import APIRouter, Header, Path, Query, Request, Response, status

from jobs.errors import ConflictError, ReusedKeyError
from jobs.records import ArtifactRecord, AssetRecord, ClientKey, JobRecord, Json
from jobs.states import JobState, JobType, stages_of
from jobs.store import new_id
from service.assets import require_room
from service.catalogue import require_preset
from service.context import Context, Ctx
from service.payloads import (
    AnimateParams,
    EstimatePayload,
    JobListPayload,
    JobPayload,
    JobRequest,
    ManifestPayload,
    RetryRequest,
    job_payload,
    manifest_payload,
)
from service.problems import ProblemError
from service.ranges import matches
from service.routing import Id, headers, refusals

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

POLL_AFTER_S = 1
MAX_PAGE = 100
KEY_EXPIRES_S = 86400.0
_REFUSALS = ("not-found", "conflict", "expired", "idempotency-key-reused", "queue-full", "disk-full")
_ACCEPTED = {
    "description": "Accepted",
    **headers(Location="the job", Retry_After="seconds until it is worth a look"),
}
Number = TypeVar("Number", int, float)


@router.post(
    "",
    operation_id="createJob",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobPayload,
    responses=refusals(*_REFUSALS)
    | {200: {"description": "validate_only: it would be accepted", "model": EstimatePayload}, 202: _ACCEPTED},
)
def create_job(
    body: JobRequest,
    response: Response,
    context: Ctx,
    validate_only: Annotated[
        bool, Query(description="only tell whether it would be accepted, and what it takes")
    ] = False,
    idempotency_key: Annotated[
        str | None, Header(min_length=1, max_length=128, description="the same key within 24 h gives the same job")
    ] = None,
) -> JobPayload | Response:
    """Ask for voxels, a spectrum, a motion, or a mesh of photos. What that needs runs first, or is cached."""
    asset, stages = _checked(context, body)
    if validate_only:
        told = EstimatePayload(
            est_seconds=_sum_of_medians(stages, context.store.stage_seconds),
            est_bytes=_sum_of_medians(stages, context.store.stage_bytes),
            format_bytes=_format_bytes(body, asset),
        )
        return Response(told.model_dump_json(), media_type="application/json")
    key = None
    if idempotency_key is not None:
        key = ClientKey(key=f"post:{idempotency_key}", body_sha256=_fingerprint(body), expires_s=KEY_EXPIRES_S)
    return _accept(context, _record(context, body, asset), stages, key, response)


@router.put(
    "/{client_id}",
    operation_id="putJob",
    status_code=status.HTTP_202_ACCEPTED,
    responses=refusals(*_REFUSALS)
    | {200: {"description": "The same was sent before; the same job", "model": JobPayload}, 202: _ACCEPTED},
)
def put_job(
    client_id: Annotated[
        str, Path(pattern=r"^[A-Za-z0-9._-]{1,128}$", description="the client's own name for the job")
    ],
    body: JobRequest,
    response: Response,
    context: Ctx,
) -> JobPayload:
    """Create a job under a name of the client's; sending it again is harmless. The job's id is in the answer."""
    asset, stages = _checked(context, body)
    key = ClientKey(key=f"put:{client_id}", body_sha256=_fingerprint(body))
    try:
        return _accept(context, _record(context, body, asset), stages, key, response)
    except ReusedKeyError as error:
        raise ConflictError(str(error)) from error


@router.post(
    "/{id}/retry",
    operation_id="retryJob",
    status_code=status.HTTP_202_ACCEPTED,
    responses=refusals(*_REFUSALS) | {202: _ACCEPTED},
)
def retry_job(id: Id, response: Response, context: Ctx, body: RetryRequest | None = None) -> JobPayload:
    """Run a job that has ended again, as a new job."""
    old = context.store.job(id)
    if not old.terminal:
        raise ConflictError(f"job {id} is {old.state}; only one that has ended can be run again")
    from_stage = body.from_stage if body is not None else None
    stages = tuple(stage.name for stage in old.stages)
    if from_stage is not None and from_stage not in stages:
        detail = f"job {id} has no stage {from_stage}; it has {', '.join(stages)}"
        errors = [{"pointer": "/from_stage", "code": "unknown-stage", "detail": detail}]
        raise ProblemError("validation-failed", detail, errors=errors)  # type: ignore[arg-type]
    _require_place(context)
    job = JobRecord(
        id=new_id(),
        type=old.type,
        state=JobState.QUEUED,
        asset_id=context.store.asset(old.asset_id).id,
        preset=old.preset,
        seed=old.seed,
        params=old.params,
        queue=context.settings.queue,
        retry_of=old.id,
        fresh_from=from_stage,
        created_at=context.store.clock(),
    )
    return _accept(context, job, stages, None, response)


@router.get("", operation_id="listJobs", responses=refusals())
def list_jobs(
    request: Request,
    response: Response,
    context: Ctx,
    state: Annotated[JobState | None, Query(description="only jobs in this state")] = None,
    type: Annotated[JobType | None, Query(description="only jobs of this type")] = None,
    cursor: Annotated[str | None, Query(description="next_cursor of the page before", pattern="^[0-9A-Z]{26}$")] = None,
    limit: Annotated[int, Query(ge=1, le=MAX_PAGE, description="jobs a page")] = 20,
) -> JobListPayload:
    """Jobs, newest first."""
    found = context.store.jobs(state=state, job_type=type, before=cursor, limit=limit + 1)
    page, more = found[:limit], len(found) > limit
    next_cursor = page[-1].id if more else None
    if next_cursor is not None:
        response.headers["Link"] = f'<{request.url.include_query_params(cursor=next_cursor)}>; rel="next"'
    data = [job_payload(job, _artifacts(context, job), context.store.queue_position(job)) for job in page]
    return JobListPayload(data=data, next_cursor=next_cursor)


@router.get(
    "/{id}",
    operation_id="getJob",
    response_model=JobPayload,
    responses=refusals("not-found")
    | {
        200: {
            "description": "The job",
            **headers(ETag="changes with the job", Retry_After="seconds, until it has ended"),
        },
        304: {"description": "Unchanged since the ETag that was sent"},
    },
)
def get_job(
    id: Id, response: Response, context: Ctx, if_none_match: Annotated[str | None, Header()] = None
) -> JobPayload | Response:
    """A job: state, stages, progress, place in the queue, products, error."""
    payload = tell(context, context.store.job(id), response)
    if matches(if_none_match, response.headers["ETag"]):
        kept = {name: response.headers[name] for name in ("ETag", "Retry-After") if name in response.headers}
        return Response(status_code=status.HTTP_304_NOT_MODIFIED, headers=kept)
    return payload


@router.post(
    "/{id}/cancel",
    operation_id="cancelJob",
    status_code=status.HTTP_202_ACCEPTED,
    responses=refusals("not-found", "conflict"),
)
def cancel_job(id: Id, response: Response, context: Ctx) -> JobPayload:
    """Stop a job: at once while it waits, within one sampler step while it runs. Asking again changes nothing."""
    return tell(context, context.store.cancel(id), response)


@router.get("/{id}/artifacts", operation_id="listArtifacts", responses=refusals("not-found"))
def list_artifacts(id: Id, context: Ctx) -> ManifestPayload:
    """The files that a job made so far, with their hashes. Stages that finished stay, whatever came after them."""
    return manifest_payload(context.store.job(id), context.store.artifacts_of(id))


def tell(context: Context, job: JobRecord, response: Response) -> JobPayload:
    """A job as it is told, with the headers that go with it."""
    position = context.store.queue_position(job)
    response.headers["ETag"] = '"' + sha256(f"{job.id} {job.version} {position}".encode()).hexdigest()[:32] + '"'
    if not job.terminal:
        response.headers["Retry-After"] = str(POLL_AFTER_S)
    return job_payload(job, _artifacts(context, job), position)


def _checked(context: Context, body: JobRequest) -> tuple[AssetRecord, tuple[JobType, ...]]:
    """The asset and the stages of a request that can be taken."""
    _require_place(context)
    if len(body.asset_id) != 26 or not body.asset_id.isalnum() or not body.asset_id.isascii():
        raise ProblemError("not-found", f"there is no asset {body.asset_id!r}; POST /v1/assets gives ids")
    asset = context.store.asset(body.asset_id)
    stages = stages_of(body.type, asset.kind)
    if "diffuse" in stages:
        require_preset(body.preset)
    if body.params.box_m is not None and asset.kind != "cloud":
        detail = f"asset {asset.id} is of kind {asset.kind}; only of a cloud a part may move"
        raise _bad_field("/params/box_m", "not-allowed", detail)
    require_room(context, sum(_format_bytes(body, asset).values()))
    return asset, stages


def _record(context: Context, body: JobRequest, asset: AssetRecord) -> JobRecord:
    now = context.store.clock()
    return JobRecord(
        id=new_id(),
        type=body.type,
        state=JobState.QUEUED,
        asset_id=asset.id,
        preset=body.preset,
        seed=body.seed,
        params=_resolved(body, asset),
        queue=context.settings.queue,
        start_deadline=None if body.start_deadline_s is None else now + body.start_deadline_s,
        created_at=now,
    )


def _accept(
    context: Context, job: JobRecord, stages: tuple[JobType, ...], key: ClientKey | None, response: Response
) -> JobPayload:
    kept, new = context.store.add_job(job, stages=stages, client_key=key)
    response.headers["Location"] = f"/v1/jobs/{kept.id}"
    if not new and key is not None and key.key.startswith("put:"):
        response.status_code = status.HTTP_200_OK
    return tell(context, kept, response)


def _fingerprint(body: JobRequest) -> str:
    return sha256(body.model_dump_json().encode()).hexdigest()


def _artifacts(context: Context, job: JobRecord) -> list[ArtifactRecord]:
    if all(stage.state == "queued" for stage in job.stages):
        return []  # the usual poll of a waiting job asks the database once less
    return context.store.artifacts_of(job.id)


def _sum_of_medians(stages: tuple[JobType, ...], history: Callable[[JobType], list[Number]]) -> Number | None:
    seen = [history(stage) for stage in stages]
    return sum(median(values) for values in seen) if all(seen) else None  # type: ignore[return-value]


def _require_place(context: Context) -> None:
    require_room(context)
    if context.store.count_jobs(JobState.QUEUED) >= context.settings.max_queued_jobs:
        raise ProblemError("queue-full", f"{context.settings.max_queued_jobs} jobs wait already, which is the limit")


def _resolved(body: JobRequest, asset: AssetRecord) -> dict[str, Json]:
    """What the worker is told: the formats of this kind of asset where none are asked for, and always a picture."""
    params: dict[str, Json] = body.params.model_dump(mode="json")
    if isinstance(body.params, AnimateParams):
        params["formats"] = list(_formats(body.params, asset))
    return params


def _formats(params: AnimateParams, asset: AssetRecord) -> tuple[str, ...]:
    from dynamictree.products import DEFAULT_CLOUD_FORMATS, DEFAULT_FORMATS

    named = params.formats or (DEFAULT_CLOUD_FORMATS if asset.kind == "cloud" else DEFAULT_FORMATS)
    return tuple(dict.fromkeys((*named, "png")))


def _format_bytes(body: JobRequest, asset: AssetRecord) -> dict[str, int]:
    """Products whose size is known beforehand.

    Raises:
        InputError: frames that make no loop, or a sequence of splats that would be too large.
    """
    if not isinstance(body.params, AnimateParams):
        return {}
    # numba comes with the products; loaded beside the first requests, not with this module
    from dynamictree.products import AnimateOptions
    from dynamictree.spectrum import FPS, NUM_FRAMES
    from dynamictree.splat_products import sequence_bytes

    given = body.params.model_dump(include={"first_frame", "num_frames", "fps", "speed", "loop", "share", "sh_degree"})
    options = AnimateOptions(**given, formats=_formats(body.params, asset))
    num_frames = len(options.phases(NUM_FRAMES / FPS))
    if "splat-ply" not in options.formats or asset.kind != "cloud":
        return {}
    count, degree = asset.summary["num_gaussians"], asset.summary["sh_degree"]
    assert isinstance(count, int)
    assert isinstance(degree, int)
    return {"splat-ply": sequence_bytes(count, degree, num_frames, options)}


def _bad_field(pointer: str, code: str, detail: str) -> ProblemError:
    return ProblemError("validation-failed", detail, errors=[{"pointer": pointer, "code": code, "detail": detail}])
