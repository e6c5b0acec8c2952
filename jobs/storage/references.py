"""Which stored bytes a row refers to, and deletion of those that none does. Computed by the database."""

from collections.abc import Callable

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.store import Store

BLOB_GRACE_S = 3600.0
"""Bytes are put before the row that refers to them; nothing takes an hour between the two."""

_REFERENCED = """
SELECT sha256 FROM artifacts WHERE expires_at > :now
UNION ALL SELECT {sha256} FROM stage_cache, {each}(stage_cache.files) AS part WHERE {source} IS NULL
UNION ALL SELECT {sha256} FROM assets, {each}(assets.parts) AS part WHERE deleted_at IS NULL
UNION ALL SELECT {prepared} FROM assets WHERE deleted_at IS NULL
"""
_DIALECTS = {
    "sqlite": {
        "each": "json_each",
        "sha256": "json_extract(part.value, '$.sha256')",
        "source": "json_extract(part.value, '$.source')",
        "prepared": "json_extract(prepared, '$.sha256')",
    },
    "postgresql": {
        "each": "json_array_elements",
        "sha256": "part.value ->> 'sha256'",
        "source": "part.value ->> 'source'",
        "prepared": "prepared ->> 'sha256'",
    },
}


def referenced(connection: sa.Connection, now: float) -> list[str]:
    """Hashes of all bytes that a row refers to, in order."""
    query = f"SELECT DISTINCT sha256 FROM ({_all_of(connection)}) AS used WHERE sha256 IS NOT NULL ORDER BY sha256"
    return list(connection.execute(sa.text(query), {"now": now}).scalars())


def unreferenced_blobs(store: Store, *, limit: int) -> list[str]:
    """Hashes of bytes that nothing refers to any more."""
    now = store.clock()
    with store.reading() as connection:
        aged = "SELECT sha256 FROM blobs WHERE touched_at < :aged"
        query = f"{aged} EXCEPT SELECT * FROM ({_all_of(connection)}) AS used LIMIT :most"
        values = {"now": now, "aged": now - BLOB_GRACE_S, "most": limit}
        return list(connection.execute(sa.text(query), values).scalars())


def forget_blob(store: Store, sha256: str, delete: Callable[[str], None]) -> None:
    """Delete bytes and their record, unless `touch_blob` has announced a new reference."""
    with store.writing() as connection:
        aged = (t.blobs.c.sha256 == sha256) & (t.blobs.c.touched_at < store.clock() - BLOB_GRACE_S)
        if connection.execute(t.blobs.delete().where(aged)).rowcount:
            delete(sha256)  # before the commit: who touches them now waits for it, and then puts them anew


def _all_of(connection: sa.Connection) -> str:
    return _REFERENCED.format(**_DIALECTS[connection.dialect.name])
