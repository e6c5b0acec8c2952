"""Checks before bytes arrive: free disk space, and the storage quota of one owner."""

import shutil

from jobs.clients.usage import stored_bytes
from jobs.storage.uploads import receiving_uploads
from service.http.problems import ProblemError
from service.services import Owned


def require_bytes(owned: Owned, wanted: int) -> None:
    """Refuse bytes beyond the owner's quota.

    Raises:
        ProblemError: with `wanted` more bytes they would keep more than is allowed.
    """
    allowed = owned.caller.limits.get("bytes")
    if allowed is None:
        return
    stored = stored_bytes(owned.store)
    if stored + wanted > allowed:
        raise ProblemError("quota-exceeded", f"you keep {stored:,} bytes, {wanted:,} more pass the {allowed:,} allowed")


def require_room(owned: Owned, wanted: int = 0) -> None:
    """Refuse what would fill the disk, together with the rest of every upload that was begun.

    Raises:
        ProblemError: less than `min_free_bytes` would be left after `wanted` more.
    """
    settings = owned.services.settings
    settings.scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    free = shutil.disk_usage(settings.scratch_dir).free
    in_storage = owned.services.artifacts.free_bytes()
    promised = 0
    if in_storage is not None:  # a folder, where parts of uploads lie too; object storage has no end that we can see
        free = min(free, in_storage)
        promised = _promised_bytes(owned)
    if free - promised - wanted < settings.min_free_bytes:
        detail = f"{free:,} bytes are free, {promised:,} of them promised to uploads, {wanted:,} wanted"
        raise ProblemError("disk-full", f"{detail}; {settings.min_free_bytes:,} are reserved")


def _promised_bytes(owned: Owned) -> int:
    """What is still to come of uploads that were begun, everybody's."""
    begun = receiving_uploads(owned.services.store)
    return sum(max(length - owned.services.upload_parts.size(upload_id), 0) for upload_id, length in begun)
