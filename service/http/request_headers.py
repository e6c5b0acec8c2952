"""Headers of requests: conditions, ranges, accepted types, `Prefer: wait`, and the trace that a job carries on.

RFC 9110 sections 12 to 14 (for one range of bytes), RFC 7240.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Header, Request

from service.http.problems import ProblemError, request_id_of

_RANGE = re.compile(r"bytes=(\d*)-(\d*)")


@dataclass(frozen=True, kw_only=True)
class ByteRange:
    """Bytes from `start` up to `stop`, not with it."""

    start: int
    stop: int


class UnsatisfiableRangeError(ValueError):
    """The range begins past the end."""


def matches(header: str | None, etag: str) -> bool:
    """Whether an If-None-Match header names this ETag; weak comparison."""
    if header is None:
        return False
    if header.strip() == "*":
        return True
    return etag in [candidate.strip().removeprefix("W/") for candidate in header.split(",")]


def parse_range(header: str | None, size: int) -> ByteRange | None:
    """The range that a header asks for; None where it is absent, malformed or more than one, which all mean the whole.

    Raises:
        UnsatisfiableRangeError: it begins past the end.
    """
    match = _RANGE.fullmatch(header.strip()) if header else None
    if match is None or match.groups() == ("", ""):
        return None
    first, last = match.groups()
    if len(first) > 18 or len(last) > 18:
        raise UnsatisfiableRangeError(header)
    if first == "":
        start, stop = max(size - int(last), 0), size
    else:
        start, stop = int(first), size if last == "" else min(int(last) + 1, size)
        if last != "" and int(last) < start:
            return None
    if start >= size or start == stop:
        raise UnsatisfiableRangeError(header)
    return ByteRange(start=start, stop=stop)


_RANGES = re.compile(r"([^\s,;]+)([^,]*)")
_QUALITY = re.compile(r";\s*q\s*=([^;]*)")

JSON = "application/json"
SAFETENSORS = "application/vnd.safetensors"


def chosen(accept: str | None, offered: Sequence[str]) -> str:
    """The offered media type with the highest quality; the first of equals. RFC 9110, section 12.5.1.

    Raises:
        ProblemError: none is acceptable.
    """
    qualities: dict[str, float] = {}
    for media_range, parameters in _RANGES.findall((accept or "*/*").lower()):
        quality = _QUALITY.search(parameters)
        try:
            qualities[media_range] = float(quality[1]) if quality else 1.0
        except ValueError as error:
            raise ProblemError("bad-request", f"Accept is {accept!r}; a quality is a number from 0 to 1") from error

    def quality_of(media_type: str) -> float:
        """By the range that names the type most closely."""
        closest_first = (media_type, media_type.partition("/")[0] + "/*", "*/*")
        return next((qualities[each] for each in closest_first if each in qualities), 0.0)

    best = max(offered, key=quality_of)
    if quality_of(best) <= 0:
        raise ProblemError("not-acceptable", f"Accept is {accept!r}; this is offered as {', '.join(offered)}")
    return best


MAX_WAIT_S = 30.0
_WAIT = re.compile(r"\bwait\s*=\s*\"?(\d{1,6})")


async def _preferred(
    prefer: Annotated[str | None, Header(description=f"wait=N waits up to N s, at most {MAX_WAIT_S:g}")] = None,
) -> float:
    match = _WAIT.search(prefer or "")
    return min(float(match.group(1)), MAX_WAIT_S) if match else 0.0


WaitS = Annotated[float, Depends(_preferred)]
"""How long the client would wait [s]."""


TRACEPARENT = "dynamictree.traceparent"
"""Where tracing may leave the context of its own span in a request's scope."""

TRACE_CONTEXT = re.compile(r"[0-9a-f]{2}-[0-9a-f]{32}-[0-9a-f]{16}-[0-9a-f]{2}")


@dataclass(frozen=True, kw_only=True)
class RequestOrigin:
    """Request id and trace context of one request."""

    request_id: str | None
    traceparent: str | None


async def _origin_of(request: Request) -> RequestOrigin:
    given = request.scope.get(TRACEPARENT) or request.headers.get("traceparent", "")
    match = TRACE_CONTEXT.fullmatch(given)
    return RequestOrigin(request_id=request_id_of(request.scope), traceparent=match.group() if match else None)


Origin = Annotated[RequestOrigin, Depends(_origin_of)]
