"""/v1/usage: the caller's usage and limits."""

from fastapi import APIRouter

from jobs.clients.keys import Limit
from jobs.clients.usage import count_active, stored_bytes
from service.http.routing import refusals
from service.schemas.base import Payload
from service.services import OwnedDep

router = APIRouter(prefix="/v1", tags=["catalogue"])


class UsagePayload(Payload):
    """What the caller has, and may have; null where no key is asked for."""

    owner: str | None
    active_jobs: int
    bytes: int
    limits: dict[Limit, int] | None


@router.get("/usage", operation_id="getUsage", responses=refusals())
def get_usage(owned: OwnedDep) -> UsagePayload:
    """Jobs that have not ended, bytes stored, and the limits of the key."""
    caller = owned.caller
    return UsagePayload(
        owner=caller.owner,
        active_jobs=count_active(owned.store),
        bytes=stored_bytes(owned.store),
        limits=dict(caller.limits) or None,
    )
