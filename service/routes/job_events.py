"""/v1/jobs/{id}/events: a job as server-sent events, one per change, until it has ended."""

import asyncio
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Response
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool

from service.http.routing import Id, refusals
from service.http.slots import until_revoked
from service.job_responses import job_payload
from service.services import Owned, OwnedDep

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

HEARTBEAT_S = 15
SEND_TIMEOUT_S = 30.0
"""Time after which a client that does not read is disconnected [s]."""


async def _counted(owned: OwnedDep) -> AsyncIterator[None]:
    """Count one of the caller's streams until its response ends; refuse one above the limit."""
    with owned.services.streams.opened(owned.caller):
        yield


@router.get(
    "/{id}/events",
    response_class=EventSourceResponse,
    dependencies=[Depends(_counted)],
    responses=refusals("not-found")
    | {
        200: {
            "description": "Events `job`; data is the job as in GET, id its version",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        }
    },
)
async def stream_job(
    id: Id,
    owned: OwnedDep,
    last_event_id: Annotated[
        str | None, Header(description="Last received version of the job, which is not sent again")
    ] = None,
) -> EventSourceResponse:
    """Stream the changes of a job. Each event is the whole job, so a client that reconnects loses nothing."""
    await run_in_threadpool(owned.store.job, id)
    seen = last_event_id if last_event_id is not None and last_event_id.isdecimal() else ""
    return EventSourceResponse(
        _events(owned, id, seen),
        ping=HEARTBEAT_S,
        send_timeout=SEND_TIMEOUT_S,
        sep="\n",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


async def _events(owned: Owned, job_id: str, seen: str) -> AsyncIterator[ServerSentEvent]:
    revoked = asyncio.create_task(until_revoked(owned.services.store, owned.caller))
    try:
        while not revoked.done():
            job = await run_in_threadpool(owned.store.job, job_id)
            if str(job.version) != seen:
                payload = await run_in_threadpool(job_payload, owned, job, Response())
                seen = str(job.version)
                yield ServerSentEvent(payload.model_dump_json(), id=seen, event="job", sep="\n")
            if job.terminal:
                return
            await owned.services.job_notifier.changed(job_id, job.version, HEARTBEAT_S)
    finally:
        revoked.cancel()
