"""Read all stored bytes again and compare them with their hashes."""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.storage.artifacts import ArtifactStore
from jobs.storage.references import is_referenced, referenced
from jobs.store import Store


@dataclass(frozen=True, kw_only=True)
class ScrubReport:
    """What was read."""

    blobs: int
    bytes: int
    missing: tuple[str, ...]
    different: tuple[str, ...]


def scrub(
    store: Store, artifacts: ArtifactStore, *, on_blob: Callable[[int, int], None] = lambda done, total: None
) -> ScrubReport:
    """Read every blob that a row refers to; `on_blob` gets how many were read, of how many."""
    with store.reading() as connection:
        digests = referenced(connection, store.clock())
    size, missing, different = 0, [], []
    for number, digest in enumerate(digests, 1):
        checksum = sha256()
        try:
            for chunk in artifacts.read(digest):
                checksum.update(chunk)
                size += len(chunk)
        except FileNotFoundError:
            if _is_referenced(store, digest):  # else retention has deleted it meanwhile
                missing.append(digest)
        else:
            if checksum.hexdigest() != digest:
                different.append(digest)
        on_blob(number, len(digests))
    return ScrubReport(blobs=len(digests), bytes=size, missing=tuple(missing), different=tuple(different))


def _is_referenced(store: Store, digest: str) -> bool:
    with store.reading() as connection:
        there = connection.execute(sa.select(t.blobs.c.sha256).where(t.blobs.c.sha256 == digest)).one_or_none()
        return there is not None and is_referenced(connection, digest, store.clock())
