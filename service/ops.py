"""/v1/ops, and the page at /ops that shows it: how the service does, without anybody's ids."""

from functools import cache
from importlib import resources
from typing import Literal

import sqlalchemy as sa
from fastapi import APIRouter, Response

from jobs import tables as t
from jobs.states import JobState
from jobs.tallies import tallies
from service.context import Ctx
from service.payloads import Payload
from service.routing import refusals

router = APIRouter()

CONTENT_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_TYPES = {"index.html": "text/html", "ops.js": "text/javascript", "style.css": "text/css"}


class QueuePayload(Payload):
    """Jobs that wait."""

    name: str
    jobs: int
    oldest_s: float


class OpsPayload(Payload):
    """The whole service at a glance."""

    queues: list[QueuePayload]
    jobs: dict[str, int]
    attempts: dict[str, int]
    workers: int
    unsent_messages: int


@router.get("/v1/ops", operation_id="getOperations", responses=refusals(), tags=["health"])
def get_operations(context: Ctx) -> OpsPayload:
    """Queues, jobs by state, attempts, workers; over all keys, and nothing of any one."""
    store = context.store
    now = store.clock()
    columns = (t.jobs.c.queue, sa.func.count(), sa.func.min(t.jobs.c.created_at))
    waiting = sa.select(*columns).where(t.jobs.c.state == JobState.QUEUED).group_by(t.jobs.c.queue)
    unsent = sa.select(sa.func.count()).select_from(t.outbox).where(t.outbox.c.sent_at.is_(None))
    there = t.leases.c.name.startswith("worker:") & (t.leases.c.until > now)
    with store.reading() as connection:
        queues = [
            QueuePayload(name=name, jobs=jobs, oldest_s=max(now - oldest, 0.0))
            for name, jobs, oldest in connection.execute(waiting)
        ]
        by_state = connection.execute(
            sa.select(t.jobs.c.state, sa.func.count().label("number")).group_by(t.jobs.c.state)
        )
        return OpsPayload(
            queues=queues,
            jobs={row.state: row.number for row in by_state},
            attempts={how: int(number) for how, number in tallies(connection).get("attempts", {}).items()},
            workers=connection.execute(sa.select(sa.func.count()).where(there)).scalar_one(),
            unsent_messages=connection.execute(unsent).scalar_one(),
        )


@router.get("/ops", include_in_schema=False)
def get_page() -> Response:
    """The operator's page."""
    return _sent("index.html")


@router.get("/ops/{name}", include_in_schema=False)
def get_part(name: Literal["ops.js", "style.css"]) -> Response:
    """What it is made of."""
    return _sent(name)


def _sent(name: str) -> Response:
    headers = {"Content-Security-Policy": CONTENT_POLICY, "Cache-Control": "no-cache"}
    return Response(_read(name), headers=headers, media_type=_TYPES[name])


@cache
def _read(name: str) -> bytes:
    return resources.files("service").joinpath("ops_page", name).read_bytes()
