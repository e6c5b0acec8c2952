"""/v1/jobs: ask for a product, look how far it is, stop it, run it again, list what it made."""

import time
from hashlib import sha256
from typing import Annotated

from fastapi import APIRouter, Header, Path, Query, Request, Response, status
from starlette.concurrency import run_in_threadpool

from jobs.errors import ConflictError, ReusedKeyError
from jobs.records import ArtifactRecord, AssetRecord, ClientKey, JobRecord, Json
from jobs.states import JobState, JobType, queue_of, stages_of
from jobs.store import new_id
from jobs.webhooks import endpoint
from service.assets import require_room
from service.catalogue import require_preset
from service.context import Context, Ctx
from service.origin import Origin, RequestOrigin
from service.payloads import (
    AnimateParams,
    EstimatePayload,
    JobListPayload,
    JobPayload,
    JobRequest,
    LogLinePayload,
    LogPayload,
    ManifestPayload,
    RetryRequest,
    job_payload,
    manifest_payload,
    time_of,
)
from service.problems import ProblemError
from service.quota import require_bytes
from service.ranges import matches
from service.routing import Id, headers, refusals
from service.waiting import WaitS

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

POLL_AFTER_S = 1
MAX_PAGE = 100
KEY_EXPIRES_S = 86400.0
_QUOTAS = ("forbidden", "quota-exceeded", "too-many-active-jobs")
_REFUSALS = ("not-found", "conflict", "expired", "idempotency-key-reused", "queue-full", "disk-full", *_QUOTAS)
_ACCEPTED = {
    "description": "Accepted",
    **headers(Location="the job", Retry_After="seconds until it is worth a look"),
}


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
    origin: Origin,
    validate_only: Annotated[
        bool, Query(description="only tell whether it would be accepted, and what it takes")
    ] = False,
    idempotency_key: Annotated[
        str | None, Header(min_length=1, max_length=128, description="the same key within 24 h gives the same job")
    ] = None,
) -> JobPayload | Response:
    """Ask for voxels, a spectrum, a motion, or a mesh of photos. What that needs runs first, or is cached."""
    if validate_only:
        asset, stages = _checked(context, body)
        told = EstimatePayload(
            est_seconds=context.history.stage_seconds(stages),
            est_bytes=context.history.stage_bytes(stages),
            format_bytes=_format_bytes(body, asset),
        )
        return Response(told.model_dump_json(), media_type="application/json")
    key = None if idempotency_key is None else f"post:{idempotency_key}"
    return accept(context, body, origin, response, key=key, expires_s=KEY_EXPIRES_S)


@router.put(
    "/{id}",
    operation_id="putJob",
    status_code=status.HTTP_202_ACCEPTED,
    responses=refusals(*_REFUSALS)
    | {200: {"description": "The same was sent before; the same job", "model": JobPayload}, 202: _ACCEPTED},
)
def put_job(
    client_id: Annotated[
        str, Path(alias="id", pattern=r"^[A-Za-z0-9._-]{1,128}$", description="the client's own name for the job")
    ],
    body: JobRequest,
    response: Response,
    context: Ctx,
    origin: Origin,
) -> JobPayload:
    """Create a job under a name of the client's; sending it again is harmless. The job's id is in the answer."""
    try:
        return accept(context, body, origin, response, key=f"put:{client_id}")
    except ReusedKeyError as error:
        raise ConflictError(str(error)) from error


@router.post(
    "/{id}/retry",
    operation_id="retryJob",
    status_code=status.HTTP_202_ACCEPTED,
    responses=refusals(*_REFUSALS) | {202: _ACCEPTED},
)
def retry_job(id: Id, response: Response, context: Ctx, origin: Origin, body: RetryRequest | None = None) -> JobPayload:
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
    require_bytes(context, 0)
    job = JobRecord(
        id=new_id(),
        type=old.type,
        state=JobState.QUEUED,
        asset_id=context.store.asset(old.asset_id).id,
        preset=old.preset,
        seed=old.seed,
        params=old.params,
        queue=old.queue,
        priority=old.priority,
        webhook_id=old.webhook_id,
        request_id=origin.request_id,
        traceparent=origin.traceparent,
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
    data = [_payload(context, job, context.store.queue_position(job), _artifacts(context, job)) for job in page]
    return JobListPayload(data=data, next_cursor=next_cursor)


@router.get(
    "/{id}",
    operation_id="getJob",
    response_model=JobPayload,
    responses=refusals("not-found", "expired")
    | {
        200: {
            "description": "The job",
            **headers(ETag="changes with the job", Retry_After="seconds, until it has ended"),
        },
        304: {"description": "Unchanged since the ETag that was sent"},
    },
)
async def get_job(
    id: Id,
    response: Response,
    context: Ctx,
    wait_s: WaitS,
    if_none_match: Annotated[str | None, Header(description="the ETag that was seen last")] = None,
) -> JobPayload | Response:
    """A job: state, stages, progress, place in the queue, products, error.

    With Prefer: wait=N the answer waits for the job's end; with If-None-Match besides, for its next change.
    """
    job, payload = await run_in_threadpool(_look, context, id, response)
    deadline = time.monotonic() + wait_s
    while wait_s and not job.terminal and if_none_match in {None, response.headers["ETag"]}:
        if not await context.watching.changed(id, job.version, deadline - time.monotonic()):
            break
        job, payload = await run_in_threadpool(_look, context, id, response)
    told = dict(response.headers)
    if wait_s:
        told["Preference-Applied"] = f"wait={wait_s:g}"
    if matches(if_none_match, told["etag"]):
        return Response(status_code=status.HTTP_304_NOT_MODIFIED, headers=told)
    # made here: FastAPI would check the payload once more, which takes longer than the queries
    return Response(payload.model_dump_json(), headers=told, media_type="application/json")


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


@router.get("/{id}/logs", operation_id="getJobLog", responses=refusals("not-found", "expired"))
def get_log(
    id: Id,
    context: Ctx,
    after: Annotated[int, Query(ge=0, le=2**62, description="next_after of the page before")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="lines a page")] = 100,
) -> LogPayload:
    """What happened to a job: accepted, begun, stages, lost workers, its end. No paths, hosts or secrets."""
    found = context.store.job_log(id, after=after, limit=limit)
    data = [
        LogLinePayload(id=n.id, at=time_of(n.at), level=n.level, message=n.message, fields=dict(n.fields))
        for n in found
    ]
    return LogPayload(data=data, next_after=found[-1].id if found else after)


def tell(context: Context, job: JobRecord, response: Response) -> JobPayload:
    """A job as it is told, with the headers that go with it."""
    return _tell(context, job, context.store.queue_position(job), _artifacts(context, job), response)


def _look(context: Context, job_id: str, response: Response) -> tuple[JobRecord, JobPayload]:
    job, position, artifacts = context.store.look(job_id)
    return job, _tell(context, job, position, artifacts, response)


def _tell(
    context: Context, job: JobRecord, position: int | None, artifacts: list[ArtifactRecord], response: Response
) -> JobPayload:
    payload = _payload(context, job, position, artifacts)
    seen = f"{job.id} {job.version} {position} {payload.eta_s}"
    response.headers["ETag"] = '"' + sha256(seen.encode()).hexdigest()[:32] + '"'
    if not job.terminal:
        response.headers["Retry-After"] = str(POLL_AFTER_S)
    elif "Retry-After" in response.headers:
        del response.headers["Retry-After"]
    return payload


def _payload(context: Context, job: JobRecord, position: int | None, artifacts: list[ArtifactRecord]) -> JobPayload:
    return job_payload(
        job,
        artifacts,
        queue_position=position,
        eta_s=context.history.eta_s(job, position),
        retention_s=context.settings.job_retention_s,
    )


def _checked(context: Context, body: JobRequest) -> tuple[AssetRecord, tuple[JobType, ...]]:
    """The asset and the stages of a request that can be taken."""
    _require_place(context)
    if len(body.asset_id) != 26 or not body.asset_id.isalnum() or not body.asset_id.isascii():
        raise ProblemError("not-found", f"there is no asset {body.asset_id!r}; POST /v1/assets gives ids")
    if body.priority == "high" and "high-priority" not in context.caller.scopes:
        raise ProblemError("forbidden", "this key may not ask for high priority; leave it at normal")
    if body.webhook is not None:
        endpoint(context.store, body.webhook)
    asset = context.store.asset(body.asset_id)
    stages = stages_of(body.type, asset.kind)
    if "diffuse" in stages:
        require_preset(body.preset)
    if body.params.box_m is not None and asset.kind != "cloud":
        detail = f"asset {asset.id} is of kind {asset.kind}; only of a cloud a part may move"
        raise _bad_field("/params/box_m", "not-allowed", detail)
    size = sum(_format_bytes(body, asset).values())
    require_room(context, size)
    require_bytes(context, size)
    return asset, stages


def _record(context: Context, body: JobRequest, asset: AssetRecord, origin: RequestOrigin) -> JobRecord:
    now = context.store.clock()
    return JobRecord(
        id=new_id(),
        type=body.type,
        state=JobState.QUEUED,
        asset_id=asset.id,
        preset=body.preset,
        seed=body.seed,
        params=_resolved(body, asset),
        queue=queue_of(context.settings.queue, body.priority),
        priority=body.priority,
        webhook_id=body.webhook,
        request_id=origin.request_id,
        traceparent=origin.traceparent,
        start_deadline=None if body.start_deadline_s is None else now + body.start_deadline_s,
        created_at=now,
    )


def accept(
    context: Context,
    body: JobRequest,
    origin: RequestOrigin,
    response: Response,
    *,
    key: str | None,
    expires_s: float | None = None,
) -> JobPayload:
    """Check a request and keep its job, or give the one that was made under the same key."""
    asset, stages = _checked(context, body)
    named = None
    if key is not None:
        named = ClientKey(key=key, body_sha256=_fingerprint(body), expires_s=expires_s)
    return _accept(context, _record(context, body, asset, origin), stages, named, response)


def _accept(
    context: Context, job: JobRecord, stages: tuple[JobType, ...], key: ClientKey | None, response: Response
) -> JobPayload:
    most = context.caller.limits.get("active_jobs")
    kept, new = context.store.add_job(job, stages=stages, client_key=key, max_active=most)
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


def _require_place(context: Context) -> None:
    require_room(context)
    if context.store.count_jobs(JobState.QUEUED) >= context.settings.max_queued_jobs:
        raise ProblemError("queue-full", f"{context.settings.max_queued_jobs} jobs wait already, which is the limit")


def _resolved(body: JobRequest, asset: AssetRecord) -> dict[str, Json]:
    """What the worker is told: the formats of this kind of asset where none are asked for, and always a picture."""
    params: dict[str, Json] = body.params.model_dump(mode="json")
    if body.params.box_m is None:
        del params["box_m"]
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
