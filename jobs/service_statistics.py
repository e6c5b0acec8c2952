"""State of the whole service over all owners, for /metrics and the operator's page."""

from dataclasses import dataclass

import sqlalchemy as sa

from jobs import tables as t
from jobs.maintenance import HOUSEKEEPER_LEASE, WORKER_LEASES
from jobs.states import JobState


@dataclass(frozen=True, kw_only=True)
class QueueLength:
    """Jobs that wait in one queue."""

    name: str
    jobs: int
    oldest_s: float  # how long the oldest waits


@dataclass(frozen=True, kw_only=True)
class Census:
    """What is counted."""

    jobs: dict[str, int]  # by state, of those with a record
    queues: tuple[QueueLength, ...]
    workers: int
    has_housekeeper: bool
    unsent_messages: int
    stored_bytes: int


def census(connection: sa.Connection, now: float) -> Census:
    """Count everything."""
    by_state = sa.select(t.jobs.c.state, sa.func.count().label("number")).group_by(t.jobs.c.state)
    lengths = (
        sa.select(t.jobs.c.queue, sa.func.count(), sa.func.min(t.jobs.c.created_at))
        .where(t.jobs.c.state == JobState.QUEUED)
        .group_by(t.jobs.c.queue)
    )
    unsent = sa.select(sa.func.count()).select_from(t.outbox).where(t.outbox.c.sent_at.is_(None))
    leases = connection.execute(sa.select(t.leases.c.name).where(t.leases.c.until > now)).scalars().all()
    stored = sa.select(sa.func.coalesce(sa.func.sum(t.blobs.c.bytes), 0))
    return Census(
        jobs={row.state: row.number for row in connection.execute(by_state)},
        queues=tuple(
            QueueLength(name=name, jobs=jobs, oldest_s=max(now - oldest, 0.0))
            for name, jobs, oldest in connection.execute(lengths)
        ),
        workers=sum(name.startswith(WORKER_LEASES) for name in leases),
        has_housekeeper=HOUSEKEEPER_LEASE in leases,
        unsent_messages=connection.execute(unsent).scalar_one(),
        stored_bytes=int(connection.execute(stored).scalar_one()),
    )
