"""Content negotiation: the offered media type that the client prefers."""

from collections.abc import Sequence

from service.http.problems import ProblemError

JSON = "application/json"
SAFETENSORS = "application/vnd.safetensors"


def chosen(accept: str | None, offered: Sequence[str]) -> str:
    """The offered media type with the highest quality; the first of equals. RFC 9110, section 12.5.1.

    Raises:
        ProblemError: none is acceptable.
    """
    ranges = [_range(part) for part in (accept or "*/*").split(",") if part.strip()]

    def quality(media_type: str) -> float:
        matching = [(rank, q) for pattern, q in ranges if (rank := _rank(pattern, media_type)) >= 0]
        return max(matching)[1] if matching else 0.0

    best = max(offered, key=quality)
    if quality(best) <= 0:
        raise ProblemError("not-acceptable", f"Accept is {accept!r}; this is offered as {', '.join(offered)}")
    return best


def _range(part: str) -> tuple[str, float]:
    media_range, *parameters = (piece.strip().lower() for piece in part.split(";"))
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name == "q":
            try:
                return media_range, min(max(float(value), 0.0), 1.0)
            except ValueError as error:
                raise ProblemError(
                    "bad-request", f"Accept has the quality {value!r}; it is a number from 0 to 1"
                ) from error
    return media_range, 1.0


def _rank(pattern: str, media_type: str) -> int:
    """How closely a range names a type: 2 exactly, 1 by its first half, 0 as anything, -1 not."""
    if pattern == media_type:
        return 2
    if pattern == media_type.partition("/")[0] + "/*":
        return 1
    return 0 if pattern == "*/*" else -1
