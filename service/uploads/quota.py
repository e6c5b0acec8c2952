"""Checks before bytes arrive: free disk space, and the storage quota of one owner."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from jobs.records import UploadRecord
from jobs.storage.disk import free_bytes
from jobs.storage.uploads import add_upload, announced_bytes, drop_upload, require_bytes_in
from jobs.store import new_id
from service.http.connections import REQUEST_TIMEOUT_S
from service.http.problems import ProblemError
from service.services import Owned

OWNER_DIVISOR, TOTAL_DIVISOR = 4, 2
"""Announced uploads reserve at most 1 / OWNER_DIVISOR of the free space per owner, and 1 / TOTAL_DIVISOR in total."""


def require_space(owned: Owned, wanted: int) -> None:
    """Refuse bytes that exceed the free disk space or the owner's quota."""
    require_room(owned, wanted)
    allowed = owned.caller.limits.get("bytes")
    if allowed is not None:
        with owned.store.reading() as connection:
            require_bytes_in(connection, owned.store, wanted, allowed)


def announce_upload(owned: Owned, lifetime_s: float, **fields: Any) -> UploadRecord:
    """Create an upload, if there is room for it."""
    now = owned.store.clock()
    record = UploadRecord(id=new_id(), created_at=now, expires_at=now + lifetime_s, **fields)
    require_room(owned, record.length or 0)
    return add_upload(owned.store, record, max_bytes=owned.caller.limits.get("bytes"))


@contextmanager
def reserve_space(owned: Owned, length: int) -> Iterator[None]:
    """Context manager that reserves room for a body of this length, like an announced upload."""
    fields = {"state": "receiving", "filename": "form", "options": {}, "length": length, "writer": "form"}
    row = announce_upload(owned, REQUEST_TIMEOUT_S, **fields)
    try:
        yield
    finally:
        drop_upload(owned.store, row.id)


def require_room(owned: Owned, wanted: int = 0) -> None:
    """Refuse bytes that would leave less than `min_free_bytes`, after the announced bytes of unfinished uploads."""
    settings, promised = owned.services.settings, 0
    free = free_bytes(settings)
    in_storage = owned.services.artifacts.free_bytes()
    room = free - settings.min_free_bytes
    if in_storage is not None:  # a folder, which also holds parts of uploads; object storage reports no limit
        free = min(free, in_storage)
        room = free - settings.min_free_bytes
        shares = (min(announced, room // OWNER_DIVISOR) for announced in announced_bytes(owned.services.store))
        promised = max(0, min(sum(shares), room // TOTAL_DIVISOR))
    if room - promised < wanted:
        detail = f"{free:,} bytes are free, {promised:,} of them promised to uploads, {wanted:,} wanted"
        raise ProblemError("disk-full", f"{detail}; {settings.min_free_bytes:,} are reserved")
