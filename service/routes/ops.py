"""/v1/ops, and the page /ops that displays it: state of the whole service, without ids."""

from typing import Literal

from fastapi import APIRouter, Request, Response

from jobs.database.counters import tallies
from jobs.lifecycle.statistics import census
from service.http.routing import refusals
from service.routes.pages import answer, content_policy, read_page
from service.schemas.base import Payload
from service.services import OwnedDep

router = APIRouter()


class QueuePayload(Payload):
    """Jobs of one queue: number waiting, age of the oldest, number running."""

    name: str
    jobs: int
    oldest_s: float
    running: int


class OpsPayload(Payload):
    """State of the whole service."""

    queues: list[QueuePayload]
    jobs: dict[str, int]
    attempts: dict[str, int]
    workers: int
    unsent_messages: int


@router.get("/v1/ops", responses=refusals(), tags=["health"])
def get_operations(owned: OwnedDep) -> OpsPayload:
    """Return queues, jobs by state, attempts and workers, as totals over all keys."""
    with owned.store.reading() as connection:
        now = census(connection, owned.store.clock())
        attempts = tallies(connection).get("attempts", {})
    return OpsPayload.of(now, attempts={how: int(number) for how, number in attempts.items()})


@router.get("/ops", include_in_schema=False)
async def get_page(request: Request) -> Response:
    """The operator's page."""
    return answer(request, await read_page("ops_page/index.html", "service"), content_policy({}))


@router.get("/ops/{name}", include_in_schema=False)
async def get_part(request: Request, name: Literal["ops.js", "style.css"]) -> Response:
    """Files of the operator's page."""
    return answer(request, await read_page(f"ops_page/{name}", "service"), content_policy({}))
