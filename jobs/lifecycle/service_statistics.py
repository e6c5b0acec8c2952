"""State of the whole service over all owners, for /metrics and the operator's page."""

from dataclasses import dataclass

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.lifecycle.maintenance import HOUSEKEEPER_LEASE, WORKER_LEASES
from jobs.states import ACTIVE, JobState


@dataclass(frozen=True, kw_only=True)
class QueueLength:
    """Jobs of one queue that have not ended."""

    name: str
    jobs: int  # that wait
    oldest_s: float  # how long the oldest waits
    running: int


@dataclass(frozen=True, kw_only=True)
class Census:
    """Counts of the whole service."""

    jobs: dict[str, int]  # by state, of those with a record
    queues: tuple[QueueLength, ...]
    workers: int
    has_housekeeper: bool
    unsent_messages: int
    stored_bytes: int


def census(connection: sa.Connection, now: float) -> Census:
    """Count everything."""
    by_state = sa.select(t.jobs.c.state, sa.func.count().label("number")).group_by(t.jobs.c.state)
    waits = t.jobs.c.state == JobState.QUEUED
    lengths = (
        sa.select(
            t.jobs.c.queue,
            sa.func.sum(sa.case((waits, 1), else_=0)).label("jobs"),
            sa.func.min(sa.case((waits, t.jobs.c.created_at))).label("oldest"),
            sa.func.count().label("unfinished"),
        )
        .where(t.jobs.c.state.in_(ACTIVE))
        .group_by(t.jobs.c.queue)
    )
    unsent = sa.select(sa.func.count()).select_from(t.outbox).where(t.outbox.c.sent_at.is_(None))
    leases = connection.execute(sa.select(t.leases.c.name).where(t.leases.c.until > now)).scalars().all()
    stored = sa.select(sa.func.coalesce(sa.func.sum(t.blobs.c.bytes), 0))
    return Census(
        jobs={row.state: row.number for row in connection.execute(by_state)},
        queues=tuple(
            QueueLength(
                name=row.queue,
                jobs=int(row.jobs),
                oldest_s=0.0 if row.oldest is None else max(now - row.oldest, 0.0),
                running=row.unfinished - int(row.jobs),
            )
            for row in connection.execute(lengths)
        ),
        workers=sum(name.startswith(WORKER_LEASES) for name in leases),
        has_housekeeper=HOUSEKEEPER_LEASE in leases,
        unsent_messages=connection.execute(unsent).scalar_one(),
        stored_bytes=int(connection.execute(stored).scalar_one()),
    )
