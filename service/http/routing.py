"""Helpers of routes: documented error responses, id parameters, cursors."""

import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fastapi import Depends, Path, Query, Response

from dynamictree.request_model import Pattern
from service.http.problems import KINDS, MEDIA_TYPE, ProblemError
from service.schemas.base import ULID_PATTERN

_PROBLEM = {"$ref": "#/components/schemas/Problem"}  # defined through JobPayload.error


def refusals(*codes: str) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI responses for the problems of a route."""
    return refusals_of(
        ("bad-request", "payload-too-large", "validation-failed", *codes, "internal-error", "storage-unavailable")
    )


def refusals_of(codes: Sequence[str]) -> dict[int | str, dict[str, Any]]:
    """Return OpenAPI responses by status; each description lists its problem codes."""
    by_status: dict[int | str, dict[str, Any]] = {}
    for code in codes:
        entry = by_status.setdefault(KINDS[code].status, {"content": {MEDIA_TYPE: {"schema": _PROBLEM}}})
        title = f"`{code}`: {KINDS[code].title}"
        entry["description"] = f"{entry['description']}; {title}" if "description" in entry else title
    return by_status


def headers(**described: str) -> Mapping[str, Any]:
    """Return the OpenAPI description of a response's headers."""
    schema = {"type": "string"}
    return {
        "headers": {name.replace("_", "-"): {"description": text, "schema": schema} for name, text in described.items()}
    }


def is_id(text: str) -> bool:
    """Return whether a text has the form of our ids."""
    return re.fullmatch(ULID_PATTERN, text) is not None


def file_route(media_type: str, description: str, *codes: str) -> dict[str, Any]:
    """Return the decorator arguments of a route that returns a file, or a problem of one of the codes."""
    file = {"description": description, "content": {media_type: {"schema": {"type": "string", "format": "binary"}}}}
    return {"response_class": Response, "responses": refusals(*codes) | {200: file}}


async def _valid_id(id: Annotated[str, Path(description="Id (ULID) that the service returned")]) -> str:
    if not is_id(id):
        raise ProblemError("not-found", f"there is nothing with the id {id[:64]!r}; ids have 26 letters and digits")
    return id


Id = Annotated[str, Depends(_valid_id)]

CACHED = {"Cache-Control": "private, max-age=86400"}
"""Headers of results that are computed from a spectrum, which never changes."""

Cursor = Annotated[
    Annotated[str, Pattern("^[0-9A-Z]{26}$", "a next_cursor: 26 letters and digits")] | None,
    Query(description="The previous page's next_cursor"),
]
