"""Durations and sizes of recent stages and jobs."""

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.states import JobState, JobType
from jobs.store import Store


def stage_seconds(store: Store, stage: JobType, *, limit: int = 50) -> list[float]:
    """Recent durations of a stage, cached runs excluded [s]."""
    ran = (t.stages.c.name == stage) & (t.stages.c.state == "succeeded") & t.stages.c.cached.is_(False)
    columns = (t.stages.c.started_at, t.stages.c.finished_at)
    query = sa.select(*columns).where(ran).order_by(t.stages.c.finished_at.desc()).limit(limit)
    with store.reading() as connection:
        return [row.finished_at - row.started_at for row in connection.execute(query)]


def stage_bytes(store: Store, stage: JobType, *, limit: int = 50) -> list[int]:
    """Recent output sizes of a stage, per job [bytes]."""
    total = sa.func.sum(t.artifacts.c.bytes)
    newest = sa.func.max(t.artifacts.c.created_at).desc()
    query = sa.select(total).where(t.artifacts.c.stage == stage).group_by(t.artifacts.c.job_id)
    with store.reading() as connection:
        return [int(value) for value in connection.execute(query.order_by(newest).limit(limit)).scalars()]


def run_seconds(store: Store, *, limit: int = 50) -> list[float]:
    """Recent run times of jobs, from start to end [s]."""
    ran = (t.jobs.c.state == JobState.SUCCEEDED) & t.jobs.c.started_at.is_not(None)
    columns = (t.jobs.c.started_at, t.jobs.c.finished_at)
    query = sa.select(*columns).where(ran).order_by(t.jobs.c.finished_at.desc()).limit(limit)
    with store.reading() as connection:
        return [row.finished_at - row.started_at for row in connection.execute(query)]
