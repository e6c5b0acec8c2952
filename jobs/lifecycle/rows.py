"""Jobs, stages and artifacts within a transaction: rows to records, and state transitions."""

from collections.abc import Mapping, Sequence

import sqlalchemy as sa

from jobs.clients.webhook_events import announce
from jobs.database import tables as t
from jobs.database.counters import count
from jobs.errors import NotFoundError, ReusedKeyError
from jobs.records import ArtifactRecord, ClientKey, JobRecord, StageRecord
from jobs.states import JobState, states_before

HIDDEN = frozenset({"lease_owner", "lease_until", "lost_stages", "client_key", "body_sha256"})
"""Columns of a job that its record does not show."""

_ID: sa.BindParameter[str] = sa.bindparam("id")
_JOB = sa.select(t.jobs).where(t.jobs.c.id == _ID)
_STAGES = sa.select(t.stages).where(t.stages.c.job_id == _ID).order_by(t.stages.c.position)
ARTIFACTS = sa.select(t.artifacts).where(t.artifacts.c.job_id == _ID).order_by(t.artifacts.c.id)


def move(connection: sa.Connection, job_id: str, target: JobState, **values: object) -> bool:
    """Change a job's state by compare-and-set; return False if its current state does not allow it."""
    allowed = (t.jobs.c.id == job_id) & t.jobs.c.state.in_(states_before(target))
    change = t.jobs.update().where(allowed).values(state=target, version=t.jobs.c.version + 1, **values)
    return connection.execute(change).rowcount == 1


def bury(connection: sa.Connection, which: sa.ColumnElement[bool], *, now: float) -> None:
    """Delete the chosen jobs, and all rows that hang on them; their ids are known as gone for a while."""
    tombs = sa.select(t.jobs.c.id, t.jobs.c.owner, sa.literal("job"), sa.literal(now)).where(which)
    connection.execute(t.tombstones.insert().from_select(["id", "owner", "kind", "gone_at"], tombs))
    connection.execute(t.jobs.delete().where(which))


def end(
    connection: sa.Connection,
    job_id: str,
    target: JobState,
    *,
    now: float,
    error_code: str | None = None,
    error_message: str | None = None,
    **values: object,
) -> bool:
    """Move a job to a final state: release its lease, withdraw its message, close its stages."""
    values |= {"finished_at": now, "lease_owner": None, "lease_until": None}
    if not move(connection, job_id, target, error_code=error_code, error_message=error_message, **values):
        return False
    of_job = t.stages.c.job_id == job_id
    left = {"state": "failed" if target == JobState.FAILED else "canceled", "finished_at": now}
    connection.execute(t.stages.update().where(of_job & (t.stages.c.state == "running")).values(**left))
    connection.execute(t.stages.update().where(of_job & (t.stages.c.state == "queued")).values(state="canceled"))
    connection.execute(t.outbox.delete().where(t.outbox.c.job_id == job_id))
    announce(connection, job_id, f"job.{target}", now=now)
    count(connection, "jobs", str(target))
    return True


def standing_of(
    connection: sa.Connection, page: Sequence[JobRecord]
) -> dict[str, tuple[int | None, list[ArtifactRecord]]]:
    """How many jobs of its queue are there before each job, None once it has begun; and what it offers so far.

    Owners take turns, as in `maintenance.unsent`.
    """
    waiting = {job.id: job.queue for job in page if job.state == JobState.QUEUED}
    positions: dict[str, int] = {}
    if waiting:
        queued = t.jobs.c.queue.in_(set(waiting.values())) & (t.jobs.c.state == JobState.QUEUED)
        place = sa.func.row_number().over(partition_by=(t.jobs.c.queue, t.jobs.c.owner), order_by=t.jobs.c.id)
        placed = sa.select(t.jobs.c.id, t.jobs.c.queue, place.label("place")).where(queued).subquery()
        turn = sa.func.row_number().over(partition_by=placed.c.queue, order_by=(placed.c.place, placed.c.id))
        turns = sa.select(placed.c.id, turn.label("turn")).subquery()
        wanted = sa.select(turns).where(turns.c.id.in_(waiting))
        positions = {row.id: row.turn - 1 for row in connection.execute(wanted)}
    begun = [job.id for job in page if any(stage.state != "queued" for stage in job.stages)]
    offered: dict[str, list[ArtifactRecord]] = {}
    if begun:
        artifacts = sa.select(t.artifacts).where(t.artifacts.c.job_id.in_(begun)).order_by(t.artifacts.c.id)
        for row in connection.execute(artifacts):
            offered.setdefault(row.job_id, []).append(ArtifactRecord(**row._mapping))
    return {job.id: (positions.get(job.id), offered.get(job.id, [])) for job in page}


def read_job(connection: sa.Connection, job_id: str) -> JobRecord:
    """One job with its stages, as this transaction sees it."""
    row = connection.execute(_JOB, {"id": job_id}).one_or_none()
    if row is None:
        raise NotFoundError(f"there is no job {job_id}")
    return job_of(row, tuple(stage_of(stage) for stage in connection.execute(_STAGES, {"id": job_id})))


def same_job(connection: sa.Connection, client_key: ClientKey) -> str:
    """The id of the job that a client's key means.

    Raises:
        ReusedKeyError: its request had another body.
    """
    query = sa.select(t.jobs.c.id, t.jobs.c.body_sha256).where(t.jobs.c.client_key == client_key.key)
    row = connection.execute(query).one()
    if row.body_sha256 != client_key.body_sha256:
        raise ReusedKeyError(f"the same key was sent with another body before, for job {row.id}; use a new key")
    return str(row.id)


def stage_of(row: sa.Row[tuple[object, ...]]) -> StageRecord:
    """A row of the table of stages."""
    values: Mapping[str, object] = {k: v for k, v in row._mapping.items() if k not in {"job_id", "position"}}
    return StageRecord(**values)  # type: ignore[arg-type]


def job_of(row: sa.Row[tuple[object, ...]], stages: tuple[StageRecord, ...]) -> JobRecord:
    """A row of the table of jobs, with the job's stages."""
    values = {k: v for k, v in row._mapping.items() if k not in HIDDEN}
    return JobRecord(**values | {"stages": stages, "state": JobState(values["state"])})
