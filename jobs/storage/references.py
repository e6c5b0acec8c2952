"""References from rows to stored bytes, computed by the database, and deletion of unreferenced bytes."""

from collections.abc import Callable
from typing import Any

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.store import Store

BLOB_GRACE_S = 3600.0
"""Age at which unreferenced bytes are deleted [s]; the row that refers to them is written much sooner."""


def referenced(connection: sa.Connection, now: float) -> list[str]:
    """Return the sorted hashes of all bytes that a row refers to."""
    used = _references(connection, now).subquery()
    query = sa.select(used.c.sha256).distinct().where(used.c.sha256.is_not(None)).order_by(used.c.sha256)
    return list(connection.execute(query).scalars())


def unreferenced_blobs(store: Store, *, limit: int) -> list[str]:
    """Return the hashes of bytes that no row refers to any more."""
    now = store.clock()
    aged = sa.select(t.blobs.c.sha256).where(t.blobs.c.touched_at < now - BLOB_GRACE_S)
    with store.reading() as connection:
        used = sa.select(_references(connection, now).subquery())
        return list(connection.execute(aged.except_(used).limit(limit)).scalars())


def _references(connection: sa.Connection, now: float) -> sa.CompoundSelect[Any]:
    """Select the hash of every reference to bytes; null if an asset has no prepared file."""
    each = sa.func.json_each if connection.dialect.name == "sqlite" else sa.func.json_array_elements

    def listed(column: sa.Column[Any]) -> sa.Select[Any]:
        file = each(column).table_valued(sa.column("value", sa.JSON))
        query = sa.select(file.c.value["sha256"].as_string()).select_from(column.table.join(file, sa.true()))
        return query.where(file.c.value["source"].as_string().is_(None))

    is_there = t.assets.c.deleted_at.is_(None)
    return sa.union_all(
        sa.select(t.artifacts.c.sha256).where(t.artifacts.c.expires_at > now),
        listed(t.stage_cache.c.files),
        listed(t.assets.c.parts).where(is_there),
        sa.select(t.assets.c.prepared["sha256"].as_string()).where(is_there),
    )


def forget_blob(store: Store, sha256: str, delete: Callable[[str], None]) -> None:
    """Delete bytes and their record, unless `touch_blob` has announced a new reference."""
    with store.writing() as connection:
        aged = (t.blobs.c.sha256 == sha256) & (t.blobs.c.touched_at < store.clock() - BLOB_GRACE_S)
        if connection.execute(t.blobs.delete().where(aged)).rowcount:
            delete(sha256)  # a concurrent `touch_blob` waits for the commit; then its caller stores them again
