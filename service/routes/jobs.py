"""/v1/jobs: create, read, list, cancel and retry jobs; list their artifacts."""

import time
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, field_validator
from starlette.concurrency import run_in_threadpool

from jobs.states import JobState, JobType
from service.http.request_headers import RequestId, WaitS, matches
from service.http.routing import Cursor, Id, headers, refusals
from service.job_creation import add_job, add_retry
from service.job_responses import job_and_payload, job_payload, payloads
from service.schemas.jobs import JobListPayload, JobPayload, JobRequest, ManifestPayload, manifest_payload
from service.services import OwnedDep

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

MAX_PAGE = 100

_QUOTAS = ("forbidden", "quota-exceeded", "too-many-active-jobs")
_REFUSALS = ("not-found", "conflict", "expired", "idempotency-key-reused", "queue-full", "disk-full", *_QUOTAS)
_ACCEPTED = {"description": "Accepted", **headers(Location="URL of the job", Retry_After="seconds until the next poll")}


@router.post("", status_code=202, responses=refusals(*_REFUSALS) | {202: _ACCEPTED})
def create_job(
    body: JobRequest,
    response: Response,
    owned: OwnedDep,
    request_id: RequestId,
    idempotency_key: Annotated[
        str | None, Header(min_length=1, max_length=128, description="The same key within 24 h returns the same job")
    ] = None,
) -> JobPayload:
    """Create a job for voxels, a spectrum, a motion, or a mesh from photos. Earlier stages run first or are cached."""
    key = None if idempotency_key is None else f"post:{idempotency_key}"
    return add_job(owned, body, request_id, response, key=key)


@router.post("/{id}/retry", status_code=202, responses=refusals(*_REFUSALS) | {202: _ACCEPTED})
def retry_job(id: Id, response: Response, owned: OwnedDep, request_id: RequestId) -> JobPayload:
    """Create a new job with the request of a job that has ended; finished stages are taken from the cache."""
    return add_retry(owned, owned.store.job(id), request_id, response)


class JobFilter(BaseModel):
    """Filter and page of a list of jobs."""

    model_config = ConfigDict(extra="ignore")

    state: JobState | None = Field(None, description="Only jobs in this state")
    type: JobType | None = Field(None, description="Only jobs of this type")
    asset_id: str | None = Field(None, max_length=64, description="Only jobs of this asset")
    external_id: str | None = Field(None, max_length=128, description="Only jobs with this external_id")
    since: datetime | None = Field(None, description="Only jobs created at or after this time")
    cursor: Cursor = None

    @field_validator("since", mode="before")
    @classmethod
    def _is_a_time(cls, value: object) -> object:
        if isinstance(value, str) and value.replace(".", "").lstrip("-").isdecimal():
            raise ValueError("since is a time as RFC 3339 writes it, such as 2026-11-25T18:00:00Z; seconds were sent")
        return value

    limit: int = Field(20, ge=1, le=MAX_PAGE, description="Jobs per page")


@router.get("", responses=refusals())
def list_jobs(
    request: Request, response: Response, owned: OwnedDep, wanted: Annotated[JobFilter, Query()]
) -> JobListPayload:
    """List jobs, newest first."""
    since_s = None if wanted.since is None else wanted.since.timestamp() - 1e-6  # times are sent in microseconds
    chosen = wanted.model_dump(include={"state", "type", "asset_id", "external_id"})
    records = owned.store.jobs(chosen, since=since_s, before=wanted.cursor, limit=wanted.limit + 1)
    page, more = records[: wanted.limit], len(records) > wanted.limit
    next_cursor = page[-1].id if more else None
    if next_cursor is not None:
        query = request.url.include_query_params(cursor=next_cursor).query
        response.headers["Link"] = f'<{request.url.path}?{query}>; rel="next"'
    return JobListPayload(data=payloads(owned, page), next_cursor=next_cursor)


@router.get(
    "/{id}",
    response_model=JobPayload,
    responses=refusals("not-found", "expired")
    | {
        200: {
            "description": "The job",
            **headers(ETag="version of the job", Retry_After="seconds until the next poll"),
        },
        304: {"description": "Unchanged since the ETag that was sent"},
    },
)
async def get_job(
    id: Id,
    response: Response,
    owned: OwnedDep,
    wait_s: WaitS,
    if_none_match: Annotated[str | None, Header(description="ETag of the last response")] = None,
) -> JobPayload | Response:
    """Return a job: state, stages, progress, queue position, products, error.

    With Prefer: wait=N, the response waits for the job's end; with If-None-Match too, for its next change.
    """
    job, payload = await run_in_threadpool(job_and_payload, owned, id, response)
    deadline = time.monotonic() + wait_s
    while wait_s and not job.terminal and if_none_match in {None, response.headers["ETag"]}:
        if not await owned.services.job_notifier.changed(id, job.version, deadline - time.monotonic()):
            break
        job, payload = await run_in_threadpool(job_and_payload, owned, id, response)
    estimate = dict(response.headers)
    if wait_s:
        estimate["Preference-Applied"] = f"wait={wait_s:g}"
    if matches(if_none_match, estimate["etag"]):
        return Response(status_code=304, headers=estimate)
    # serialized here: FastAPI would validate the payload again, which takes longer than the queries
    return Response(payload.model_dump_json(), headers=estimate, media_type="application/json")


@router.post("/{id}/cancel", status_code=202, responses=refusals("not-found", "conflict"))
def cancel_job(id: Id, response: Response, owned: OwnedDep) -> JobPayload:
    """Cancel a job: at once if it waits, within one sampler step if it runs. A repeated request changes nothing."""
    return job_payload(owned, owned.store.cancel(id), response)


@router.delete("/{id}", status_code=204, responses=refusals("not-found", "conflict", "expired"))
def delete_job(id: Id, owned: OwnedDep) -> None:
    """Delete a job that has ended, and its files. Files that it shares with other jobs remain."""
    owned.store.delete_job(id)


@router.get("/{id}/artifacts", responses=refusals("not-found"))
def list_artifacts(id: Id, owned: OwnedDep) -> ManifestPayload:
    """List the files that a job has made so far, with hashes. Files of finished stages remain if a later one fails."""
    return manifest_payload(owned.store.job(id), owned.store.artifacts_of(id))
