"""Build response bodies of jobs, and their headers."""

from collections.abc import Sequence
from hashlib import sha256

from fastapi import Response

from jobs.records import ArtifactRecord, JobRecord
from jobs.storage.assets import asset_summaries
from jobs.storage.stage_files import MESH, SPECTRUM, VOXELS
from service.schemas.assets import AssetSummary
from service.schemas.base import problem_of
from service.schemas.jobs import JobPayload, ResultPayload
from service.services import Owned

POLL_AFTER_S = 1


def job_payload(owned: Owned, job: JobRecord, response: Response) -> JobPayload:
    """Return the response body of a job, and set the response's headers."""
    [payload] = payloads(owned, [job])
    seen = f"{job.id} {job.version} {payload.queue_position}"  # not the forecast, which differs between processes
    response.headers["ETag"] = '"' + sha256(seen.encode()).hexdigest()[:32] + '"'
    if not job.terminal:
        response.headers["Retry-After"] = str(POLL_AFTER_S)
    elif "Retry-After" in response.headers:  # set by an earlier look for the same response
        del response.headers["Retry-After"]
    return payload


def job_and_payload(owned: Owned, job_id: str, response: Response) -> tuple[JobRecord, JobPayload]:
    """Read a job: its record and response body."""
    job = owned.store.job(job_id)
    return job, job_payload(owned, job, response)


def payloads(owned: Owned, page: Sequence[JobRecord]) -> list[JobPayload]:
    """Return the response bodies of jobs; the number of queries does not grow with the number of jobs."""
    seen = owned.store.positions_and_artifacts(page)
    sources = asset_summaries(owned.store, {job.asset_id for job in page if seen[job.id][1]})
    retention_s = owned.services.settings.job_retention_s
    bodies = []
    for job in page:
        position, artifacts = seen[job.id]
        body = JobPayload.of(
            job,
            **vars(owned.services.job_durations.forecast(job, position)),
            result=_result(job, artifacts, sources.get(job.asset_id)) if artifacts else None,
            error=problem_of(job.error_code, job.error_message),
            webhook=job.webhook_id,
            expires_at=None if job.finished_at is None else job.finished_at + retention_s,
        )
        bodies.append(body)
    return bodies


def _result(job: JobRecord, artifacts: Sequence[ArtifactRecord], source: AssetSummary | None) -> ResultPayload:
    ids = {artifact.name: artifact.id for artifact in artifacts}
    facts = {artifact.name: artifact.facts for artifact in artifacts}
    return ResultPayload.of(
        job,
        mesh_id=ids.get(MESH),
        voxels_id=ids.get(VOXELS),
        spectrum_id=ids.get(SPECTRUM),
        source=source,
        warnings=facts.get("report.json", {}).get("warnings", []),
        artifacts_url=f"/v1/jobs/{job.id}/artifacts",
    )
