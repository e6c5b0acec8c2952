"""/v1/jobs/{id}/events: a job as server-sent events, one for each change, until it has ended."""

import time
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header, Response
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool

from service.http.routing import Id, refusals
from service.job_responses import tell
from service.services import Owned, OwnedDep

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

HEARTBEAT_S = 15.0


@router.get(
    "/{id}/events",
    operation_id="streamJob",
    response_class=StreamingResponse,
    responses=refusals("not-found")
    | {
        200: {
            "description": "Events `job`; data is the job as GET gives it, id its version",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        }
    },
)
def stream_job(
    id: Id,
    owned: OwnedDep,
    last_event_id: Annotated[
        str | None, Header(description="the version that was seen last; it is not told again")
    ] = None,
) -> StreamingResponse:
    """Follow a job. Each event is the whole job, so that who comes back late misses nothing that matters."""
    owned.store.job(id)
    seen = last_event_id if last_event_id is not None and last_event_id.isdecimal() else ""
    return StreamingResponse(
        _events(owned, id, seen),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


async def _events(owned: Owned, job_id: str, seen: str) -> AsyncIterator[bytes]:
    quiet_since = time.monotonic()
    while True:
        job = await run_in_threadpool(owned.store.job, job_id)
        if str(job.version) != seen:
            payload = await run_in_threadpool(tell, owned, job, Response())
            seen, quiet_since = str(job.version), time.monotonic()
            yield f"id: {seen}\nevent: job\ndata: {payload.model_dump_json()}\n\n".encode()
        if job.terminal:
            return
        left = quiet_since + HEARTBEAT_S - time.monotonic()
        if not await owned.services.job_notifier.changed(job_id, job.version, max(left, 0.0)):
            quiet_since = time.monotonic()
            yield b": still there\n\n"
