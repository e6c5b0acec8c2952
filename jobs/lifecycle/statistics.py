"""State of the whole service over all owners, and durations of recent stages and jobs."""

from dataclasses import dataclass

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.lifecycle.maintenance import HOUSEKEEPER_LEASE, WORKER_LEASES
from jobs.states import ACTIVE, JobState, JobType
from jobs.store import Store


@dataclass(frozen=True, kw_only=True)
class QueueLength:
    """Jobs of one queue that have not ended."""

    name: str
    jobs: int  # number of waiting jobs
    oldest_s: float  # time that the oldest has waited
    running: int


@dataclass(frozen=True, kw_only=True)
class Census:
    """Counts of the whole service."""

    jobs: dict[str, int]  # number of jobs with a record, by state
    queues: tuple[QueueLength, ...]
    workers: int
    has_housekeeper: bool
    unsent_messages: int
    stored_bytes: int


def census(connection: sa.Connection, now: float) -> Census:
    """Count the jobs of the whole service."""
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


def stage_seconds(store: Store, stage: JobType) -> list[float]:
    """Return recent durations of a stage, without cached runs [s]."""
    ran = (t.stages.c.name == stage) & (t.stages.c.state == "succeeded") & t.stages.c.cached.is_(False)
    return _recent_seconds(store, t.stages, ran)


def run_seconds(store: Store) -> list[float]:
    """Return recent run times of jobs, from start to end [s]."""
    return _recent_seconds(store, t.jobs, (t.jobs.c.state == JobState.SUCCEEDED) & t.jobs.c.started_at.is_not(None))


def _recent_seconds(store: Store, table: sa.Table, ran: sa.ColumnElement[bool], *, limit: int = 50) -> list[float]:
    query = sa.select(table.c.started_at, table.c.finished_at).where(ran).order_by(table.c.finished_at.desc())
    with store.reading() as connection:
        return [row.finished_at - row.started_at for row in connection.execute(query.limit(limit))]
