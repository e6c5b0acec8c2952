"""Rows of assets (checked uploads). The same files of the same owner are the same asset."""

from collections.abc import Collection
from dataclasses import asdict, replace
from hashlib import sha256
from typing import Any

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.database.engine import insert_new
from jobs.database.retry import retry_while_unavailable
from jobs.errors import ConflictError, GoneError, NotFoundError
from jobs.records import AssetRecord
from jobs.states import ACTIVE
from jobs.store import Store


def add_asset(store: Store, asset: AssetRecord) -> tuple[AssetRecord, bool]:
    """Store an asset, or return the existing one with the same fingerprint, and whether it is new."""
    with store.writing() as connection:
        asset = replace(asset, owner=store.owner or "")
        live = _live_key(store, asset.fingerprint)
        values = asdict(asset) | {"live_fingerprint": live, "bytes": asset.bytes}
        if insert_new(connection, t.assets, values, unique="live_fingerprint"):
            return asset, True
        same = t.assets.c.live_fingerprint == live
        changes = {"expires_at": asset.expires_at} | ({"metadata": asset.metadata} if asset.metadata else {})
        connection.execute(t.assets.update().where(same).values(**changes))
        return t.record_of(AssetRecord, connection.execute(sa.select(t.assets).where(same)).one()), False


def find_asset(store: Store, fingerprint: str) -> AssetRecord | None:
    """Find the undeleted asset with this fingerprint."""
    this = t.assets.c.live_fingerprint == _live_key(store, fingerprint)
    with store.reading() as connection:
        row = connection.execute(sa.select(t.assets).where(this)).one_or_none()
    return None if row is None else t.record_of(AssetRecord, row)


def _live_key(store: Store, fingerprint: str) -> str:
    """Unique key of an undeleted asset: owners have separate assets but share bytes."""
    return sha256(f"{store.owner} {fingerprint}".encode()).hexdigest() if store.owner else fingerprint


@retry_while_unavailable
def read_asset(store: Store, asset_id: str) -> AssetRecord:
    """Read one asset."""
    with store.reading() as connection:
        this = (t.assets.c.id == asset_id) & store.owned(t.assets)
        row = connection.execute(sa.select(t.assets).where(this)).one_or_none()
    if row is None:
        raise NotFoundError(f"there is no asset {asset_id}")
    asset = t.record_of(AssetRecord, row)
    if asset.deleted_at is not None:
        raise GoneError(f"asset {asset_id} was deleted or has expired; upload it again")
    return asset


def asset_summaries(store: Store, asset_ids: Collection[str]) -> dict[str, dict[str, Any]]:
    """Return the summaries of assets by id, including deleted ones whose record still exists."""
    these = t.assets.c.id.in_(asset_ids) & store.owned(t.assets)
    with store.reading() as connection:
        rows = connection.execute(sa.select(t.assets.c.id, t.assets.c.summary).where(these)) if asset_ids else ()
        return {row.id: row.summary for row in rows}


def delete_asset(store: Store, asset_id: str) -> None:
    """Delete an asset; the next retention run deletes its bytes.

    Raises:
        ConflictError: a job that has not ended needs it.
    """
    read_asset(store, asset_id)
    with store.writing() as connection:
        active = t.jobs.c.state.in_(ACTIVE) & (t.jobs.c.asset_id == asset_id)
        job_id = connection.execute(sa.select(t.jobs.c.id).where(active).limit(1)).scalar_one_or_none()
        if job_id is not None:
            raise ConflictError(f"asset {asset_id} is in use by job {job_id}; cancel it or wait for its end")
        gone = {"live_fingerprint": None, "deleted_at": store.clock()}
        connection.execute(t.assets.update().where(t.assets.c.id == asset_id).values(**gone))
