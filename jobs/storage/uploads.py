"""Rows of uploads: length, bytes received, and the resulting asset or error."""

from collections import Counter
from dataclasses import asdict, replace
from typing import Any

import sqlalchemy as sa

from jobs.clients.usage import stored_bytes_in
from jobs.database import tables as t
from jobs.errors import BytesQuotaError, ConflictError, GoneError, NotFoundError
from jobs.records import UploadRecord, UploadState
from jobs.store import Store

MAX_OPEN = 1000
"""Limit of unfinished uploads per owner: one set of photos with masks and cameras has 640 files."""


def add_upload(store: Store, upload: UploadRecord, *, max_bytes: int | None = None) -> UploadRecord:
    """Store a new upload; its announced length counts towards the quota.

    If too many uploads are unfinished, the oldest one without a byte is removed.

    Raises:
        BytesQuotaError: the owner would have more than `max_bytes`, or too many uploads are unfinished.
    """
    upload = replace(upload, owner=store.owner or "")
    with store.writing() as connection:
        store.lock_owner(connection)
        if max_bytes is not None:
            require_bytes_in(connection, store, upload.length or 0, max_bytes)
        begun = (t.uploads.c.state == "receiving") & (t.uploads.c.owner == upload.owner)
        if connection.execute(sa.select(sa.func.count()).where(begun)).scalar_one() >= MAX_OPEN:
            idle = begun & (t.uploads.c.received == 0) & t.uploads.c.writer.is_(None)
            oldest = sa.select(t.uploads).where(idle).order_by(t.uploads.c.id).limit(1)
            row = connection.execute(oldest).one_or_none()
            if row is None:
                raise BytesQuotaError(f"{MAX_OPEN} of your uploads have begun, which is the limit; end some")
            _delete_with_tombstone(connection, row, now=store.clock())
        connection.execute(t.uploads.insert().values(**asdict(upload)))
    return upload


def require_bytes_in(connection: sa.Connection, store: Store, wanted: int, allowed: int) -> None:
    """Refuse bytes beyond an owner's quota, within a transaction.

    Raises:
        BytesQuotaError: with `wanted` more bytes the owner has more than `allowed`.
    """
    stored = stored_bytes_in(connection, store)
    if stored + wanted > allowed:
        raise BytesQuotaError(f"you keep {stored:,} bytes, {wanted:,} more pass the {allowed:,} allowed")


def drop_upload(store: Store, upload_id: str) -> None:
    """Delete the row of an upload that no client knows."""
    with store.writing() as connection:
        connection.execute(t.uploads.delete().where(t.uploads.c.id == upload_id))


def upload(store: Store, upload_id: str) -> UploadRecord:
    """Read one upload."""
    with store.reading() as connection:
        return _read(connection, store, upload_id)


def change_upload(store: Store, upload_id: str, *, was: tuple[UploadState, ...] = (), **values: object) -> UploadRecord:
    """Change an upload, if it is still in one of the states `was`.

    Raises:
        ConflictError: the upload is in another state.
    """
    with store.writing() as connection:
        before = _read(connection, store, upload_id)
        if was and before.state not in was:
            raise ConflictError(f"upload {upload_id} is {before.state}, not {' or '.join(was)}")
        if values:
            connection.execute(t.uploads.update().where(t.uploads.c.id == upload_id).values(**values))
        return _read(connection, store, upload_id)


def claim_uploads(store: Store, *, lease_s: float, limit: int, per_owner: int) -> list[UploadRecord]:
    """Claim uploads to fetch or to make assets of, each for `lease_s`; at most `per_owner` of one owner at once."""
    now = store.clock()
    waiting = (t.uploads.c.state == "fetching") | ((t.uploads.c.state == "received") & t.uploads.c.make_asset)
    free = t.uploads.c.lease_until.is_(None) | (t.uploads.c.lease_until < now)
    with store.reading() as connection:
        running = Counter(connection.execute(sa.select(t.uploads.c.owner).where(waiting & ~free)).scalars())
        place = sa.func.row_number().over(partition_by=t.uploads.c.owner, order_by=t.uploads.c.id).label("place")
        ranked = sa.select(t.uploads.c.id, t.uploads.c.owner, place).where(waiting & free).subquery()
        rows = connection.execute(sa.select(ranked).where(ranked.c.place <= per_owner)).all()
    turns = sorted((row.place + running[row.owner], row.id) for row in rows)
    ids = [upload_id for turn, upload_id in turns if turn <= per_owner][:limit]
    claimed = []
    for upload_id in ids:
        with store.writing() as connection:
            this = (t.uploads.c.id == upload_id) & waiting & free
            change = t.uploads.update().where(this).values(lease_until=now + lease_s).returning(*t.uploads.c)
            claimed += [t.record_of(UploadRecord, row) for row in connection.execute(change)]
    return claimed


def announced_bytes(store: Store) -> list[int]:
    """Return the bytes that unfinished uploads still announce, one sum per owner [bytes]."""
    begun = (t.uploads.c.state == "receiving") & (t.uploads.c.expires_at >= store.clock())
    left = sa.select(sa.func.sum(t.uploads.c.length - t.uploads.c.received)).where(begun).group_by(t.uploads.c.owner)
    with store.reading() as connection:
        return [int(total or 0) for total in connection.execute(left).scalars()]


def expired_uploads(store: Store, *, limit: int) -> list[str]:
    """Return the ids of expired uploads."""
    with store.reading() as connection:
        old = sa.select(t.uploads.c.id).where(t.uploads.c.expires_at < store.clock()).limit(limit)
        return list(connection.execute(old).scalars())


def delete_upload(store: Store, upload_id: str) -> None:
    """Delete an upload's record, if it is still there; the caller deletes its bytes first."""
    with store.writing() as connection:
        row = connection.execute(sa.select(t.uploads).where(t.uploads.c.id == upload_id)).one_or_none()
        if row is not None:
            _delete_with_tombstone(connection, row, now=store.clock())


def _delete_with_tombstone(connection: sa.Connection, row: sa.Row[Any], *, now: float) -> None:
    connection.execute(t.uploads.delete().where(t.uploads.c.id == row.id))
    tomb = {"id": row.id, "owner": row.owner, "kind": "upload", "gone_at": now}
    connection.execute(t.tombstones.insert().values(**tomb))


def _read(connection: sa.Connection, store: Store, upload_id: str) -> UploadRecord:
    this = (t.uploads.c.id == upload_id) & store.owned(t.uploads)
    row = connection.execute(sa.select(t.uploads).where(this)).one_or_none()
    if row is not None and row.expires_at > store.clock():
        return t.record_of(UploadRecord, row)
    tomb = sa.select(t.tombstones.c.id).where((t.tombstones.c.id == upload_id) & store.owned(t.tombstones))
    if row is not None or connection.execute(tomb).one_or_none() is not None:
        raise GoneError(f"upload {upload_id} was removed or has expired; begin it anew")
    raise NotFoundError(f"there is no upload {upload_id}")
