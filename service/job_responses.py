"""Build a job's response body and its headers."""

from hashlib import sha256

from fastapi import Response

from jobs.records import ArtifactRecord, JobRecord
from jobs.storage.assets import asset_summaries
from service.schemas.jobs import JobPayload, job_payload
from service.services import Owned

POLL_AFTER_S = 1


def tell(owned: Owned, job: JobRecord, response: Response) -> JobPayload:
    """Response body of a job; sets the response's headers."""
    return _job_response(owned, job, *owned.store.standing(job), response)


def look(owned: Owned, job_id: str, response: Response) -> tuple[JobRecord, JobPayload]:
    """Read a job in one transaction: its record and response body.

    Raises:
        NotFoundError, GoneError: there is none, or its record has expired.
    """
    job, position, artifacts = owned.store.look(job_id)
    return job, _job_response(owned, job, position, artifacts, response)


def listed(owned: Owned, page: list[JobRecord]) -> list[JobPayload]:
    """Response bodies of a page of jobs, with as many queries as for one of them."""
    seen = owned.store.standing_of(page)
    sources = asset_summaries(owned.store, {job.asset_id for job in page if seen[job.id][1]})
    durations = owned.services.job_durations.for_one_answer()
    retention_s = owned.services.settings.job_retention_s
    payloads = []
    for job in page:
        position, artifacts = seen[job.id]
        source, forecast = sources.get(job.asset_id), durations.forecast(job, position)
        payloads.append(job_payload(job, artifacts, source=source, forecast=forecast, retention_s=retention_s))
    return payloads


def _job_response(
    owned: Owned, job: JobRecord, position: int | None, artifacts: list[ArtifactRecord], response: Response
) -> JobPayload:
    source = asset_summaries(owned.store, {job.asset_id}).get(job.asset_id) if artifacts else None
    seen = f"{job.id} {job.version} {position}"  # not the forecast: each process has medians of its own
    response.headers["ETag"] = '"' + sha256(seen.encode()).hexdigest()[:32] + '"'
    if not job.terminal:
        response.headers["Retry-After"] = str(POLL_AFTER_S)
    elif "Retry-After" in response.headers:  # of an earlier look in the same answer
        del response.headers["Retry-After"]
    return job_payload(
        job,
        artifacts,
        source=source,
        forecast=owned.services.job_durations.forecast(job, position),
        retention_s=owned.services.settings.job_retention_s,
    )
