"""/v1/links: addresses of files that open without a key's header, for a while."""

from typing import Annotated

from fastapi import APIRouter, Response
from pydantic import Field

from jobs.clients.keys import find_key
from jobs.storage.assets import read_asset
from service.http.problems import ProblemError
from service.http.routing import refusals
from service.http.signed_links import LINKABLE, signed
from service.schemas.base import Payload, Time
from service.services import Owned, OwnedDep

router = APIRouter(prefix="/v1/links", tags=["artifacts"])

DAY_S = 86400


class LinkRequest(Payload):
    """Path to open without a key, and for how long."""

    path: Annotated[
        str,
        Field(
            max_length=128,
            description="Path of an artifact, a spectrum, or a tree's surface, modes, reach or points",
            examples=["/v1/artifacts/01ARZ3NDEKTSV4RRFFQ69G5FAV"],
        ),
    ]
    expires_s: Annotated[int, Field(ge=1, le=7 * DAY_S, description="Lifetime of the link [s]")] = 3600


class LinkPayload(Payload):
    """A signed link, with which anyone can GET the file."""

    url: str = Field(description="Path and query, relative to the service's address")
    expires_at: Time | None = Field(description="Null if no key is required; then the path suffices")


@router.post("", status_code=201, responses=refusals("not-found", "expired"))
def create_link(body: LinkRequest, owned: OwnedDep, response: Response) -> LinkPayload:
    """Sign a path, so that `<model-viewer src>` or a download manager can open it without a header.

    The link expires after its lifetime, with the key that created it, or with the file.
    """
    _require_file(owned, body.path)
    response.headers["Cache-Control"] = "no-store"
    key = find_key(owned.services.store, id=owned.caller.key_id)
    if key is None:
        return LinkPayload(url=body.path, expires_at=None)
    expires = int(owned.services.store.clock()) + body.expires_s
    return LinkPayload.of(None, url=signed(key, body.path, expires), expires_at=expires)


def _require_file(owned: Owned, path: str) -> None:
    if LINKABLE.fullmatch(path) is None:
        allowed = "/v1/artifacts/{id}, /v1/spectra/{id}[/surface|/modes|/reach], /v1/assets/{id}/surface|points"
        raise ProblemError("not-found", f"no link can be made of {path!r}; {allowed} are allowed")
    kind, object_id = path.split("/")[2:4]
    if kind == "assets":
        read_asset(owned.store, object_id)
    else:
        owned.store.artifact(object_id)
