"""What routes have in common: documented refusals, ids that are ids, pages of problems in OpenAPI."""

import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fastapi import Depends, Path

from service.problems import KINDS, MEDIA_TYPE, ProblemError

_PROBLEM = {"$ref": "#/components/schemas/Problem"}  # there by way of JobPayload.error
_ULID = re.compile(r"[0-9A-HJKMNP-TV-Z]{26}")


def refusals(*codes: str) -> dict[int | str, dict[str, Any]]:
    """The problems that a route answers with, for its OpenAPI page."""
    return refusals_of(
        ("bad-request", "payload-too-large", "validation-failed", *codes, "internal-error", "storage-unavailable")
    )


def refusals_of(codes: Sequence[str]) -> dict[int | str, dict[str, Any]]:
    """Responses by status; each names the codes that it may hold."""
    by_status: dict[int | str, dict[str, Any]] = {}
    for code in codes:
        title = KINDS[code].title
        entry = by_status.setdefault(
            KINDS[code].status, {"content": {MEDIA_TYPE: {"schema": _PROBLEM, "examples": {}}}}
        )
        entry["description"] = f"{entry['description']}; {title}" if "description" in entry else title
        entry["content"][MEDIA_TYPE]["examples"][code] = {"$ref": f"#/components/examples/{code}"}
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
