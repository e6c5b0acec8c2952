"""Erase all data of one owner: keys, files, jobs, products, webhooks and tombstones."""

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.errors import ConflictError
from jobs.states import ACTIVE, JobState
from jobs.storage.artifacts import ArtifactStore
from jobs.storage.references import referenced
from jobs.storage.upload_parts import PartStore
from jobs.store import Store


def erase_owner(store: Store, artifacts: ArtifactStore, parts: PartStore, owner: str) -> dict[str, int]:
    """Delete all rows of an owner, then the bytes to which no other rows refer; return the number per kind.

    Keys are revoked first. Queued jobs are canceled; running ones must end before.

    Raises:
        ConflictError: a job of the owner is running; its cancellation was requested.
    """
    theirs = store.for_owner(owner)
    now = store.clock()
    with store.writing() as connection:
        mine = (t.api_keys.c.owner == owner) & t.api_keys.c.revoked_at.is_(None)
        connection.execute(t.api_keys.update().where(mine).values(revoked_at=now))
    _stop_jobs(theirs, owner)
    with store.reading() as connection:
        digests = _digests(connection, owner)
        uploads = list(connection.execute(sa.select(t.uploads.c.id).where(t.uploads.c.owner == owner)).scalars())
    for upload_id in uploads:
        parts.delete(upload_id)
    with store.writing() as connection:
        counted = _delete_rows(connection, owner)
        digests |= _forget_cached(connection, digests)
        left = digests - set(referenced(connection, now))
        connection.execute(t.blobs.delete().where(t.blobs.c.sha256.in_(left)))
    for digest in left:
        artifacts.delete(digest)
    return counted | {"blobs": len(left)}


def _stop_jobs(theirs: Store, owner: str) -> None:
    active = t.jobs.c.state.in_(ACTIVE) & (t.jobs.c.owner == owner)
    with theirs.reading() as connection:
        ids = list(connection.execute(sa.select(t.jobs.c.id).where(active)).scalars())
    running = [job_id for job_id in ids if theirs.cancel(job_id).state != JobState.CANCELED]
    if running:
        raise ConflictError(f"{len(running)} jobs of {owner} still run and were asked to stop; repeat in a minute")


def _digests(connection: sa.Connection, owner: str) -> set[str]:
    """Return the sha256 of all bytes that an owner's rows refer to."""
    digests: set[str] = set()
    for row in connection.execute(sa.select(t.assets.c.parts, t.assets.c.prepared).where(t.assets.c.owner == owner)):
        digests |= {part["sha256"] for part in row.parts}
        if row.prepared is not None:
            digests.add(row.prepared["sha256"])
    products = sa.select(t.artifacts.c.sha256).join(t.jobs, t.jobs.c.id == t.artifacts.c.job_id)
    return digests | set(connection.execute(products.where(t.jobs.c.owner == owner)).scalars())


def _delete_rows(connection: sa.Connection, owner: str) -> dict[str, int]:
    """Delete an owner's rows, with those that depend on jobs and endpoints, and the tombstones; return counts."""
    counted = {}
    tables = {"webhooks": t.webhook_endpoints, "jobs": t.jobs, "assets": t.assets, "uploads": t.uploads}
    for name, table in (tables | {"keys": t.api_keys}).items():
        counted[name] = connection.execute(table.delete().where(table.c.owner == owner)).rowcount
    for table in (t.tombstones, t.usage):
        connection.execute(table.delete().where(table.c.owner == owner))
    return counted


def _forget_cached(connection: sa.Connection, digests: set[str]) -> set[str]:
    """Delete cached stages that made or used any of these files; return all files that they name.

    If an entry of another owner is deleted, its result is just computed again.
    """
    forgotten: set[str] = set()
    for row in connection.execute(sa.select(t.stage_cache.c.key, t.stage_cache.c.files)).all():
        files = {file["sha256"] for file in row.files}
        if files & digests:
            connection.execute(t.stage_cache.delete().where(t.stage_cache.c.key == row.key))
            forgotten |= files
    return forgotten
