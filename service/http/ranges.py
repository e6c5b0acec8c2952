"""Conditional and partial requests. RFC 9110 sections 13 and 14, for one range of bytes."""

import re
from dataclasses import dataclass

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
