"""/v1/jobs: ask for a product, look how far it is, stop it, list what it made."""

from hashlib import sha256
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response, status

from jobs.records import ArtifactRecord, JobRecord
from jobs.states import JobState, JobType, stages_of
from jobs.store import new_id
from service.assets import require_room
from service.catalogue import require_preset
from service.context import Context, Ctx
from service.payloads import (
    AnimateParams,
    JobListPayload,
    JobPayload,
    JobRequest,
    ManifestPayload,
    job_payload,
    manifest_payload,
)
from service.problems import ProblemError
from service.ranges import matches
from service.routing import Id, headers, refusals

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

POLL_AFTER_S = 1
MAX_PAGE = 100


@router.post(
    "",
    operation_id="createJob",
    status_code=status.HTTP_202_ACCEPTED,
    responses=refusals("not-found", "conflict", "expired", "queue-full", "disk-full")
    | {202: {"description": "Accepted", **headers(Location="the job", Retry_After="seconds until it is worth a look")}},
)
def create_job(body: JobRequest, response: Response, context: Ctx) -> JobPayload:
    """Ask for voxels, a spectrum, a motion, or a mesh of photos. What that needs runs first, or is cached."""
    require_room(context)
    store = context.store
    asset = store.asset(_checked_id(body.asset_id))
    stages = stages_of(body.type, asset.kind)
    if "diffuse" in stages:
        require_preset(body.preset)
    if isinstance(body.params, AnimateParams):
        _require_loop(body.params)
    if store.count_jobs(JobState.QUEUED) >= context.settings.max_queued_jobs:
        raise ProblemError("queue-full", f"{context.settings.max_queued_jobs} jobs wait already, which is the limit")
    job = JobRecord(
        id=new_id(),
        type=body.type,
        state=JobState.QUEUED,
        asset_id=asset.id,
        preset=body.preset,
        seed=body.seed,
        params=body.params.model_dump(mode="json"),
        queue=context.settings.queue,
        created_at=store.clock(),
    )
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return _told(context, store.add_job(job, stages=stages), response)


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
    told = _told(context, context.store.job(id), response)
    if matches(if_none_match, response.headers["ETag"]):
        kept = {name: response.headers[name] for name in ("ETag", "Retry-After") if name in response.headers}
        return Response(status_code=status.HTTP_304_NOT_MODIFIED, headers=kept)
    return told


@router.post(
    "/{id}/cancel",
    operation_id="cancelJob",
    status_code=status.HTTP_202_ACCEPTED,
    responses=refusals("not-found", "conflict"),
)
def cancel_job(id: Id, response: Response, context: Ctx) -> JobPayload:
    """Stop a job: at once while it waits, within one sampler step while it runs. Asking again changes nothing."""
    return _told(context, context.store.cancel(id), response)


@router.get("/{id}/artifacts", operation_id="listArtifacts", responses=refusals("not-found"))
def list_artifacts(id: Id, context: Ctx) -> ManifestPayload:
    """The files that a job made so far, with their hashes. Stages that finished stay, whatever came after them."""
    return manifest_payload(context.store.job(id), context.store.artifacts_of(id))


def _told(context: Context, job: JobRecord, response: Response) -> JobPayload:
    position = context.store.queue_position(job)
    payload = job_payload(job, _artifacts(context, job), position)
    response.headers["ETag"] = '"' + sha256(f"{job.id} {job.version} {position}".encode()).hexdigest()[:32] + '"'
    if not job.terminal:
        response.headers["Retry-After"] = str(POLL_AFTER_S)
    return payload


def _artifacts(context: Context, job: JobRecord) -> list[ArtifactRecord]:
    if all(stage.state == "queued" for stage in job.stages):
        return []  # the usual poll of a waiting job asks the database once less
    return context.store.artifacts_of(job.id)


def _checked_id(asset_id: str) -> str:
    if len(asset_id) != 26 or not asset_id.isalnum() or not asset_id.isascii():
        raise ProblemError("not-found", f"there is no asset {asset_id!r}; POST /v1/assets gives ids")
    return asset_id


def _require_loop(params: AnimateParams) -> None:
    # numba comes with the pipeline; loaded at start-up, not with this module
    from dynamictree.products import AnimateOptions
    from dynamictree.spectrum import FPS, NUM_FRAMES

    options = AnimateOptions(
        num_frames=params.num_frames,
        fps=params.fps,
        speed=params.speed,
        loop=params.loop,
        formats=params.formats,
    )
    options.phases(NUM_FRAMES / FPS)
