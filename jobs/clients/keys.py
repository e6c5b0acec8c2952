"""API keys: printed once, stored as a hash, revoked by id. A key acts for its owner; an owner may have many."""

import secrets
from collections.abc import Mapping
from dataclasses import asdict
from hashlib import sha256

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.errors import NotFoundError
from jobs.records import SCOPES, KeyRecord, Limit, Scope
from jobs.store import Store, new_id

PREFIX = "dt_"


def create_key(
    store: Store,
    *,
    name: str,
    owner: str | None = None,
    scopes: tuple[Scope, ...] = SCOPES,
    limits: Mapping[Limit, int] | None = None,
    expires_s: float | None = None,
) -> tuple[KeyRecord, str]:
    """Create a key; the second value is the key itself, which is not stored."""
    key = PREFIX + secrets.token_urlsafe(32)
    key_id, now = new_id(), store.clock()
    record = KeyRecord(
        id=key_id,
        owner=owner or key_id,
        name=name,
        digest=digest_of(key),
        scopes=scopes,
        limits=limits or {},
        created_at=now,
        expires_at=None if expires_s is None else now + expires_s,
    )
    with store.writing() as connection:
        connection.execute(t.api_keys.insert().values(**asdict(record)))
    return record, key


def digest_of(key: str) -> str:
    """Return the hash that is stored in place of a key. A key has 256 random bits, so a fast hash is enough."""
    return sha256(key.encode()).hexdigest()


def find_key(store: Store, **column: str) -> KeyRecord | None:
    """Find the key with this `id` or `digest`, valid or not."""
    with store.reading() as connection:
        row = connection.execute(sa.select(t.api_keys).filter_by(**column)).one_or_none()
    return None if row is None else t.record_of(KeyRecord, row)


USE_WRITTEN_S = 3600.0
"""Interval at which a key's last use is written [s]; a write per request would cost more than most requests."""


def record_use(store: Store, key: KeyRecord) -> None:
    """Record the time of use of a key, at most once per interval."""
    now = store.clock()
    stale = t.api_keys.c.last_used_at.is_(None) | (t.api_keys.c.last_used_at < now - USE_WRITTEN_S)
    if key.last_used_at is None or key.last_used_at < now - USE_WRITTEN_S:
        with store.writing() as connection:
            connection.execute(t.api_keys.update().where((t.api_keys.c.id == key.id) & stale).values(last_used_at=now))


def keys(store: Store) -> list[KeyRecord]:
    """Return all keys, oldest first."""
    with store.reading() as connection:
        return [
            t.record_of(KeyRecord, row) for row in connection.execute(sa.select(t.api_keys).order_by(t.api_keys.c.id))
        ]


def revoke_key(store: Store, key_id: str) -> None:
    """Revoke a key. Its owner's data stay.

    Raises:
        NotFoundError: there is no such key, or it is already revoked.
    """
    living = (t.api_keys.c.id == key_id) & t.api_keys.c.revoked_at.is_(None)
    with store.writing() as connection:
        if connection.execute(t.api_keys.update().where(living).values(revoked_at=store.clock())).rowcount == 0:
            raise NotFoundError(f"there is no living key {key_id}; `dynamictree keys list` shows the ids")
