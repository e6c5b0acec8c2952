"""Headers of requests: conditions, ranges, accepted types, `Prefer: wait`, and the request's id."""

import re
from collections.abc import Sequence
from typing import Annotated

from fastapi import Depends, Header, Request
from werkzeug.datastructures import MIMEAccept
from werkzeug.http import parse_accept_header, parse_etags, parse_range_header

from service.http.problems import ProblemError, request_id_of

JSON = "application/json"
SAFETENSORS = "application/vnd.safetensors"


def matches(header: str | None, etag: str) -> bool:
    """Return whether an If-None-Match header lists this ETag, by weak comparison."""
    return header is not None and parse_etags(header).contains_weak(etag.strip('"'))


def parse_range(header: str | None, size: int) -> range | None:
    """Return the requested range of bytes; None, for the whole file, if there is no valid range or more than one.

    A range that begins after the end is refused.
    """
    wanted = parse_range_header(header)
    nothing = header == "bytes=-0"  # the last 0 bytes, which werkzeug rejects as malformed
    if not nothing and (wanted is None or wanted.units != "bytes" or len(wanted.ranges) != 1):
        return None
    start, stop = (size, size) if wanted is None else wanted.ranges[0]
    wanted_bytes = range(max(start + size, 0) if start < 0 else start, size if stop is None else min(stop, size))
    if not wanted_bytes:
        detail = f"the range {header!r} lies outside of the file's {size:,} bytes"
        raise ProblemError("range-not-satisfiable", detail, headers={"Content-Range": f"bytes */{size}"})
    return wanted_bytes


def preferred_media_type(accept: str | None, offered: Sequence[str]) -> str:
    """Return the offered media type with the highest quality; the first of equals."""
    accepted = parse_accept_header(accept or "*/*", MIMEAccept)
    if not accepted:
        raise ProblemError("bad-request", f"Accept is {accept!r}; a quality is a number from 0 to 1")
    best = max(offered, key=accepted.quality)
    if accepted.quality(best) <= 0:
        raise ProblemError("not-acceptable", f"Accept is {accept!r}; this is offered as {', '.join(offered)}")
    return best


MAX_WAIT_S = 30.0
_WAIT = re.compile(r"\bwait\s*=\s*\"?(\d{1,6})")


async def _preferred(
    prefer: Annotated[str | None, Header(description=f"wait=N: wait up to N s, at most {MAX_WAIT_S:g}")] = None,
) -> float:
    match = _WAIT.search(prefer or "")
    return min(float(match.group(1)), MAX_WAIT_S) if match else 0.0


WaitS = Annotated[float, Depends(_preferred)]
"""Time that the client is ready to wait for the response [s]."""


async def _request_id(request: Request) -> str | None:
    return request_id_of(request.scope)


RequestId = Annotated[str | None, Depends(_request_id)]
"""Id of the request, stored in the record of its job."""
