"""Read all stored bytes again and compare them with their hashes."""

from dataclasses import dataclass

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.storage.artifacts import ArtifactStore, hash_stored
from jobs.storage.references import is_referenced, referenced
from jobs.store import Store


@dataclass(frozen=True, kw_only=True)
class ScrubReport:
    """What was read."""

    blobs: int
    bytes: int
    missing: tuple[str, ...]
    different: tuple[str, ...]


def scrub(store: Store, artifacts: ArtifactStore) -> ScrubReport:
    """Read every blob that a row refers to."""
    with store.reading() as connection:
        digests = referenced(connection, store.clock())
    sizes: list[int] = []
    missing, different = [], []
    for digest in digests:
        stored = hash_stored(artifacts, digest, lambda chunk: sizes.append(len(chunk)))
        if stored is None and _is_referenced(store, digest):  # else retention has deleted it meanwhile
            missing.append(digest)
        elif stored not in (None, digest):
            different.append(digest)
    return ScrubReport(blobs=len(digests), bytes=sum(sizes), missing=tuple(missing), different=tuple(different))


def _is_referenced(store: Store, digest: str) -> bool:
    with store.reading() as connection:
        there = connection.execute(sa.select(t.blobs.c.sha256).where(t.blobs.c.sha256 == digest)).one_or_none()
        return there is not None and is_referenced(connection, digest, store.clock())
