"""Back up the job store and its bytes into a folder, restore them into an empty state, verify hashes.

The folder has `database.jsonl.gz` (a header, then one line per row, in one snapshot) and `blobs/ab/abcd…` by sha256. A
later backup into the same folder copies only new bytes. Rows are read in one transaction; the housekeeper deletes no
bytes while a backup holds its lease. SQLite and PostgreSQL restore into one another.
"""

import gzip
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.errors import BackupError, ConflictError
from jobs.lifecycle.maintenance import hold_lease, release_lease
from jobs.storage.artifacts import ArtifactStore, hash_file, hash_stored
from jobs.storage.references import referenced
from jobs.store import Store, new_id

BACKUP_LEASE = "backup"
LEASE_S = 600.0
FORMAT = 2
DATABASE, BLOBS = "database.jsonl.gz", "blobs"
NOT_SAVED = frozenset({"leases"})
"""Tables that are not backed up: leases mean nothing to later processes."""


@dataclass(frozen=True, kw_only=True)
class BackupReport:
    """Number of saved or restored rows and files."""

    rows: int
    blobs: int
    bytes: int
    copied: int  # number of new blobs
    damaged: tuple[str, ...] = ()  # sha256 of blobs that are missing or damaged


def back_up(store: Store, artifacts: ArtifactStore, folder: Path) -> BackupReport:
    """Save every row, and all bytes that a row refers to.

    Raises:
        ConflictError: another backup is running.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    owner = new_id()
    if not hold_lease(store, BACKUP_LEASE, owner=owner, lease_s=LEASE_S):
        raise ConflictError("another backup runs, or ended less than ten minutes ago without saying so; wait for it")
    try:
        with store.reading(of_one_moment=True) as connection:
            rows = _write_rows(connection, folder / f"{DATABASE}.part")
            digests = referenced(connection, store.clock())
        copied, total, damaged = 0, 0, []
        for digest in digests:
            hold_lease(store, BACKUP_LEASE, owner=owner, lease_s=LEASE_S)
            target = folder / BLOBS / digest[:2] / digest
            if not target.exists():
                if not _save_blob(artifacts, digest, target):
                    damaged.append(digest)
                    continue
                copied += 1
            total += target.stat().st_size
        (folder / f"{DATABASE}.part").replace(folder / DATABASE)  # rows last, since they refer to the bytes
    finally:
        release_lease(store, BACKUP_LEASE, owner=owner)
    saved = len(digests) - len(damaged)
    return BackupReport(rows=rows, blobs=saved, bytes=total, copied=copied, damaged=tuple(damaged))


def restore(store: Store, artifacts: ArtifactStore, folder: Path) -> BackupReport:
    """Fill an empty store with a backup. Running jobs start again; incomplete uploads are left out.

    Raises:
        ConflictError: the store is not empty.
        BackupError: the backup cannot be read, or some of its bytes are damaged; nothing was written.
    """
    saved = list(_read_rows(folder / DATABASE))
    with store.reading() as connection:
        for table in (t.api_keys, t.assets, t.jobs, t.uploads):
            if connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one():
                raise ConflictError(f"there are rows in {table.name}; restore into an empty database")
    blobs = sorted(path for path in (folder / BLOBS).rglob("*") if path.is_file())
    damaged = [path.name for path in blobs if hash_file(path)[0] != path.name]
    if damaged:
        raise BackupError(f"{len(damaged)} files of the backup have another hash, the first is {damaged[0]}")
    for path in blobs:
        artifacts.put(path, path.name)
    size = sum(path.stat().st_size for path in blobs)
    with store.writing() as connection:
        connection.execute(t.tallies.delete())
        for table in t.metadata.sorted_tables:
            mine = [row for name, row in saved if name == table.name]
            if table is t.uploads:
                mine = [row for row in mine if row["state"] in {"ready", "failed"}]
            rows = [{name: row[name] for name in row.keys() & table.c.keys()} for row in mine]  # drop removed columns
            if rows:
                connection.execute(table.insert(), rows)
        connection.execute(t.outbox.update().values(sent_at=None))  # the queue was not backed up
    return BackupReport(rows=len(saved), blobs=len(blobs), bytes=size, copied=len(blobs))


def _write_rows(connection: sa.Connection, path: Path) -> int:
    number = 0
    path.touch(mode=0o600)
    with gzip.open(path, "wt") as stream:
        stream.write(json.dumps({"format": FORMAT, "revision": t.REVISION}) + "\n")
        for table in t.metadata.sorted_tables:
            if table.name in NOT_SAVED:
                continue
            for row in connection.execute(sa.select(table)):
                stream.write(json.dumps([table.name, dict(row._mapping)]) + "\n")
                number += 1
    return number


def _read_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    try:
        with gzip.open(path, "rt") as stream:
            header = json.loads(stream.readline())
            if header["format"] != FORMAT or header["revision"] > t.REVISION:
                saved_as = f"format {header['format']}, revision {header['revision']}"
                raise BackupError(f"{path} is of {saved_as}; this program restores {FORMAT}, {t.REVISION}")
            for line in stream:
                name, row = json.loads(line)
                yield name, row
    except (OSError, EOFError, ValueError, KeyError) as error:
        raise BackupError(f"{path} cannot be read: {error}") from error


def _save_blob(artifacts: ArtifactStore, digest: str, target: Path) -> bool:
    """Copy bytes and verify their hash; return whether they are stored and correct."""
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".part-{digest}")
    try:
        part.touch(mode=0o600)
        with part.open("wb") as stream:
            stored = hash_stored(artifacts, digest, stream.write)
            stream.flush()
            os.fsync(stream.fileno())
        if stored == digest:
            part.replace(target)
        return stored == digest
    finally:
        part.unlink(missing_ok=True)


@dataclass(frozen=True, kw_only=True)
class ScrubReport:
    """Result of a scrub."""

    blobs: int
    bytes: int
    missing: tuple[str, ...]
    different: tuple[str, ...]


def scrub(store: Store, artifacts: ArtifactStore) -> ScrubReport:
    """Read every blob that a row refers to and compare it with its hash."""
    with store.reading() as connection:
        digests = referenced(connection, store.clock())
    sizes: list[int] = []
    absent, different = set[str](), []
    for digest in digests:
        stored = hash_stored(artifacts, digest, lambda chunk: sizes.append(len(chunk)))
        if stored is None:
            absent.add(digest)
        elif stored != digest:
            different.append(digest)
    with store.reading() as connection:  # retention has meanwhile deleted blobs that no row refers to any more
        missing = tuple(digest for digest in referenced(connection, store.clock()) if digest in absent)
    return ScrubReport(blobs=len(digests), bytes=sum(sizes), missing=missing, different=tuple(different))
