"""/v1/ops, and the page /ops that displays it: state of the whole service, without ids."""

from functools import cache
from importlib import resources
from typing import Literal

from fastapi import APIRouter, Response

from jobs.database.counters import tallies
from jobs.lifecycle.statistics import census
from service.http.routing import refusals
from service.schemas.base import Payload
from service.services import OwnedDep

router = APIRouter()

CONTENT_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_TYPES = {"index.html": "text/html", "ops.js": "text/javascript", "style.css": "text/css"}


class QueuePayload(Payload):
    """Jobs of one queue: how many wait, for how long the oldest does, how many run."""

    name: str
    jobs: int
    oldest_s: float
    running: int


class OpsPayload(Payload):
    """The whole service at a glance."""

    queues: list[QueuePayload]
    jobs: dict[str, int]
    attempts: dict[str, int]
    workers: int
    unsent_messages: int


@router.get("/v1/ops", responses=refusals(), tags=["health"])
def get_operations(owned: OwnedDep) -> OpsPayload:
    """Queues, jobs by state, attempts, workers; over all keys, and nothing of any one."""
    with owned.store.reading() as connection:
        now = census(connection, owned.store.clock())
        attempts = tallies(connection).get("attempts", {})
    return OpsPayload.of(now, attempts={how: int(number) for how, number in attempts.items()})


@router.get("/ops", include_in_schema=False)
def get_page() -> Response:
    """The operator's page."""
    return _sent("index.html")


@router.get("/ops/{name}", include_in_schema=False)
def get_part(name: Literal["ops.js", "style.css"]) -> Response:
    """Files of the operator's page."""
    return _sent(name)


def _sent(name: str) -> Response:
    headers = {"Content-Security-Policy": CONTENT_POLICY, "Cache-Control": "no-cache"}
    return Response(_read(name), headers=headers, media_type=_TYPES[name])


@cache
def _read(name: str) -> bytes:
    return resources.files("service").joinpath("ops_page", name).read_bytes()
