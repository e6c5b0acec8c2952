"""Bytes stored and jobs running, for quotas."""

from collections.abc import Collection

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.states import JobState
from jobs.store import Store

MEASURES = ("attempts", "processor_s", "gpu_s")


def stored_bytes(store: Store) -> int:
    """Return the total size of the owner's assets, uploads, products and intermediates [bytes]."""
    with store.reading() as connection:
        return stored_bytes_in(connection, store)


def stored_bytes_in(connection: sa.Connection, store: Store) -> int:
    """Compute `stored_bytes` within a transaction, in one statement."""
    live = t.assets.c.deleted_at.is_(None) & store.owned(t.assets)
    sums = (
        sa.select(sa.func.sum(t.assets.c.bytes)).where(live),
        sa.select(sa.func.sum(t.uploads.c.length)).where(t.uploads.c.asset_id.is_(None) & store.owned(t.uploads)),
        sa.select(sa.func.sum(t.stage_cache.c.bytes)).where(store.owned(t.stage_cache)),
        sa.select(sa.func.sum(t.artifacts.c.bytes))
        .join(t.jobs, t.jobs.c.id == t.artifacts.c.job_id)
        .where((t.artifacts.c.expires_at > store.clock()) & store.owned(t.jobs)),
    )
    return sum(int(value or 0) for value in connection.execute(sa.select(*(s.scalar_subquery() for s in sums))).one())


def months(store: Store, *, limit: int = 12) -> list[dict[str, object]]:
    """Return the resource use of the owner's attempts by month, newest first."""
    columns = (t.usage.c.month, *(sa.func.sum(t.usage.c[name]).label(name) for name in MEASURES))
    query = sa.select(*columns).where(store.owned(t.usage)).group_by(t.usage.c.month).order_by(t.usage.c.month.desc())
    with store.reading() as connection:
        return [dict(row._mapping) for row in connection.execute(query.limit(limit))]


def count_jobs(store: Store, states: Collection[JobState]) -> int:
    """Count the jobs in any of these states."""
    wanted = t.jobs.c.state.in_(states) & store.owned(t.jobs)
    with store.reading() as connection:
        return connection.execute(sa.select(sa.func.count()).where(wanted)).scalar_one()
