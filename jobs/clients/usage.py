"""Bytes stored and jobs running, for quotas."""

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.states import ACTIVE, JobState
from jobs.store import Store

MEASURES = ("attempts", "processor_s", "gpu_s")


def stored_bytes(store: Store) -> int:
    """What the owner's assets, uploads, products and intermediates take [bytes]."""
    with store.reading() as connection:
        return stored_bytes_in(connection, store)


def stored_bytes_in(connection: sa.Connection, store: Store) -> int:
    """`stored_bytes` as a transaction sees them, in one statement."""
    live = t.assets.c.deleted_at.is_(None) & store.mine(t.assets)
    sums = (
        sa.select(sa.func.sum(t.assets.c.bytes)).where(live),
        sa.select(sa.func.sum(t.uploads.c.length)).where(t.uploads.c.asset_id.is_(None) & store.mine(t.uploads)),
        sa.select(sa.func.sum(t.stage_cache.c.bytes)).where(store.mine(t.stage_cache)),
        sa.select(sa.func.sum(t.artifacts.c.bytes))
        .join(t.jobs, t.jobs.c.id == t.artifacts.c.job_id)
        .where((t.artifacts.c.expires_at > store.clock()) & store.mine(t.jobs)),
    )
    return sum(int(value or 0) for value in connection.execute(sa.select(*(s.scalar_subquery() for s in sums))).one())


def months(store: Store, *, limit: int = 12) -> list[dict[str, object]]:
    """What attempts of the owner's jobs took, by month, newest first."""
    columns = (t.usage.c.month, *(sa.func.sum(t.usage.c[name]).label(name) for name in MEASURES))
    query = sa.select(*columns).where(store.mine(t.usage)).group_by(t.usage.c.month).order_by(t.usage.c.month.desc())
    with store.reading() as connection:
        return [dict(row._mapping) for row in connection.execute(query.limit(limit))]


def count_active(store: Store) -> int:
    """How many jobs have not ended."""
    active = t.jobs.c.state.in_(ACTIVE) & store.mine(t.jobs)
    with store.reading() as connection:
        return connection.execute(sa.select(sa.func.count()).where(active)).scalar_one()


def count_jobs(store: Store, state: JobState) -> int:
    """How many jobs are in a state."""
    with store.reading() as connection:
        return connection.execute(sa.select(sa.func.count()).where(t.jobs.c.state == state)).scalar_one()
