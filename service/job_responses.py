"""Build response bodies of jobs, and their headers."""

from collections.abc import Sequence
from hashlib import sha256

from fastapi import Response

from jobs.records import JobRecord
from jobs.storage.assets import asset_summaries
from service.schemas.jobs import JobPayload, job_payload
from service.services import Owned

POLL_AFTER_S = 1


def tell(owned: Owned, job: JobRecord, response: Response) -> JobPayload:
    """Response body of a job; sets the response's headers."""
    [payload] = payloads(owned, [job])
    seen = f"{job.id} {job.version} {payload.queue_position}"  # not the forecast: each process has medians of its own
    response.headers["ETag"] = '"' + sha256(seen.encode()).hexdigest()[:32] + '"'
    if not job.terminal:
        response.headers["Retry-After"] = str(POLL_AFTER_S)
    elif "Retry-After" in response.headers:  # of an earlier look in the same answer
        del response.headers["Retry-After"]
    return payload


def look(owned: Owned, job_id: str, response: Response) -> tuple[JobRecord, JobPayload]:
    """Read a job: its record and response body.

    Raises:
        NotFoundError, GoneError: there is none, or its record has expired.
    """
    job = owned.store.job(job_id)
    return job, tell(owned, job, response)


def payloads(owned: Owned, page: Sequence[JobRecord]) -> list[JobPayload]:
    """Response bodies of jobs, with as many queries as for one of them."""
    seen = owned.store.standing_of(page)
    sources = asset_summaries(owned.store, {job.asset_id for job in page if seen[job.id][1]})
    durations = owned.services.job_durations.for_one_answer()
    retention_s = owned.services.settings.job_retention_s
    bodies = []
    for job in page:
        position, artifacts = seen[job.id]
        source, forecast = sources.get(job.asset_id), durations.forecast(job, position)
        bodies.append(job_payload(job, artifacts, source=source, forecast=forecast, retention_s=retention_s))
    return bodies
