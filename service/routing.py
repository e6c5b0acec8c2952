"""What routes have in common: documented refusals, ids that are ids, pages of problems in OpenAPI."""

import re
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import Depends, Path

from service.problems import KINDS, MEDIA_TYPE, ProblemError

_PROBLEM = {"$ref": "#/components/schemas/Problem"}  # there by way of JobPayload.error
_ULID = re.compile(r"[0-9A-HJKMNP-TV-Z]{26}")


def refusals(*codes: str) -> dict[int | str, dict[str, Any]]:
    """The problems that a route answers with, for its OpenAPI page."""
    by_status: dict[int | str, dict[str, Any]] = {}
    for code in (
        "bad-request",
        "payload-too-large",
        "validation-failed",
        *codes,
        "internal-error",
        "storage-unavailable",
    ):
        status = KINDS[code].status
        title = KINDS[code].title
        if status in by_status:
            title = f"{by_status[status]['description']}; {title}"
        by_status[status] = {"description": title, "content": {MEDIA_TYPE: {"schema": _PROBLEM}}}
    return by_status


def headers(**described: str) -> Mapping[str, Any]:
    """Headers of a response, for its OpenAPI page."""
    return {
        "headers": {
            name.replace("_", "-"): {"description": text, "schema": {"type": "string"}}
            for name, text in described.items()
        }
    }


async def _known_shape(id: Annotated[str, Path(description="a ULID, as the service gave it")]) -> str:
    if not _ULID.fullmatch(id):
        raise ProblemError("not-found", f"there is nothing with the id {id[:64]!r}; ids have 26 letters and digits")
    return id


Id = Annotated[str, Depends(_known_shape)]
