"""What one owner may keep here."""

from jobs.usage import kept_bytes
from service.context import Context
from service.http.problems import ProblemError


def require_bytes(context: Context, wanted: int) -> None:
    """Refuse what an owner has no room for.

    Raises:
        ProblemError: with `wanted` more bytes they would keep more than is allowed.
    """
    allowed = context.caller.limits.get("bytes")
    if allowed is None:
        return
    kept = kept_bytes(context.store)
    if kept + wanted > allowed:
        raise ProblemError("quota-exceeded", f"you keep {kept:,} bytes, {wanted:,} more pass the {allowed:,} allowed")
