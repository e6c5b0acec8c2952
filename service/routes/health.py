"""/livez and /readyz: whether the process and its dependencies respond."""

import logging
from typing import Literal

import sqlalchemy as sa
from fastapi import APIRouter, Response

from jobs.errors import StorageAwayError
from jobs.lifecycle.maintenance import HOUSEKEEPER_LEASE, WORKER_LEASES, lease_names
from jobs.storage import parser_process
from jobs.storage.disk import free_bytes
from jobs.storage.parser_process import reader_works
from service.http.routing import refusals
from service.schemas.base import Payload
from service.services import Owned, OwnedDep

router = APIRouter(tags=["health"])
logger = logging.getLogger(__name__)

REDIS_TIMEOUT_S = 2.0
Check = Literal["ok", "unavailable", "full", "absent"]


class LivePayload(Payload):
    """Liveness of the process."""

    status: Literal["ok"] = "ok"


class ReadyPayload(Payload):
    """State of the parts; `reader` reads uploads, absent before it starts. Any state but ok and absent is 503."""

    status: Literal["ready", "unready"]
    database: Check
    redis: Check
    storage: Check
    reader: Check
    workers: Check
    housekeeper: Check


@router.get("/livez", responses=refusals())
async def get_liveness() -> LivePayload:
    """Return status 200 if the process responds."""
    return LivePayload()


@router.get(
    "/readyz",
    responses=refusals() | {503: {"description": "A dependency of the service is unavailable", "model": ReadyPayload}},
)
def get_readiness(response: Response, owned: OwnedDep) -> ReadyPayload:
    """Return whether the service can accept and run jobs."""
    database, there = _database(owned)
    used = parser_process.server.control is not None
    reader: Check = "absent" if not used else "ok" if reader_works(owned.services.settings) else "unavailable"
    checks = {"database": database, "redis": _redis(owned), "storage": _storage(owned), "reader": reader}
    ready = all(check in ("ok", "absent") for check in checks.values())
    if not ready:
        logger.warning("not ready", extra=checks)
        response.status_code = 503
        response.headers["Retry-After"] = "5"
    return ReadyPayload(
        status="ready" if ready else "unready",
        workers="ok" if any(name.startswith(WORKER_LEASES) for name in there) else "absent",
        housekeeper="ok" if HOUSEKEEPER_LEASE in there else "absent",
        **checks,
    )


def _database(owned: Owned) -> tuple[Check, list[str]]:
    try:
        return "ok", lease_names(owned.store, "")
    except sa.exc.SQLAlchemyError:
        logger.warning("the database is away", exc_info=True)
        return "unavailable", []


def _redis(owned: Owned) -> Check:
    from redis import Redis, RedisError  # a third of this package's import time

    timeouts = {"socket_timeout": REDIS_TIMEOUT_S, "socket_connect_timeout": REDIS_TIMEOUT_S}
    try:
        with Redis.from_url(owned.services.settings.resolved_redis_url, **timeouts) as client:
            client.ping()
    except RedisError:
        logger.warning("redis is away", exc_info=True)
        return "unavailable"
    return "ok"


def _storage(owned: Owned) -> Check:
    try:
        in_storage, in_state = owned.services.artifacts.free_bytes(), free_bytes(owned.services.settings)
    except (OSError, StorageAwayError):
        logger.warning("the artefact storage is away", exc_info=True)
        return "unavailable"
    free = in_state if in_storage is None else min(in_storage, in_state)
    return "full" if free < owned.services.settings.min_free_bytes else "ok"
