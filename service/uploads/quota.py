"""What one owner may keep here."""

from jobs.usage import kept_bytes
from service.http.problems import ProblemError
from service.services import Owned


def require_bytes(owned: Owned, wanted: int) -> None:
    """Refuse what an owner has no room for.

    Raises:
        ProblemError: with `wanted` more bytes they would keep more than is allowed.
    """
    allowed = owned.caller.limits.get("bytes")
    if allowed is None:
        return
    kept = kept_bytes(owned.store)
    if kept + wanted > allowed:
        raise ProblemError("quota-exceeded", f"you keep {kept:,} bytes, {wanted:,} more pass the {allowed:,} allowed")
