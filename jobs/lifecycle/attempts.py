"""A worker's changes to the job that it runs.

Every write names the attempt: if another one began, or the job ended, FencedError is raised and nothing is written.
"""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.database.counters import count, count_seconds
from jobs.database.engine import insert_or_add, upsert
from jobs.database.retry import retry_while_unavailable
from jobs.errors import FencedError
from jobs.lifecycle.rows import end_job, queue_deliveries, read_job
from jobs.records import FIRST_ARTIFACT, Claim, OutputFile
from jobs.states import JobState, JobType, queues_of
from jobs.store import Store, new_id


@retry_while_unavailable
def claim(store: Store, job_id: str, attempt: int, *, owner: str, lease_s: float) -> Claim | None:
    """Claim an attempt by compare-and-set, if it is still due and unclaimed."""
    now = store.clock()
    with store.writing() as connection:
        free = t.jobs.c.lease_owner.is_(None) | (t.jobs.c.lease_owner == owner)  # claimed by us: the answer was lost
        waiting = (
            (t.jobs.c.id == job_id)
            & (t.jobs.c.attempt == attempt)
            & free
            & t.jobs.c.state.in_([JobState.QUEUED, JobState.RUNNING])
        )
        taken = {
            "state": JobState.RUNNING,
            "lease_owner": owner,
            "lease_until": now + lease_s,
            "started_at": sa.func.coalesce(t.jobs.c.started_at, now),
            "version": t.jobs.c.version + 1,
        }
        if connection.execute(t.jobs.update().where(waiting).values(**taken)).rowcount == 0:
            return None
        connection.execute(t.outbox.delete().where(t.outbox.c.job_id == job_id))
        count(connection, "attempts", "started")
        return Claim(job=read_job(connection, job_id), owner=owner)


def renew(store: Store, job_id: str, attempt: int, *, owner: str, lease_s: float) -> None:
    """Renew the lease."""
    with store.writing() as connection:
        mine = _running_attempt(job_id, attempt, owner)
        change = t.jobs.update().where(mine).values(lease_until=store.clock() + lease_s)
        if connection.execute(change).rowcount == 0:
            raise _fenced(job_id, attempt)


@retry_while_unavailable
def cancel_requested(store: Store, claimed: Claim) -> bool:
    """Return whether cancellation of this job was requested."""
    with store.reading() as connection:
        state = connection.execute(sa.select(t.jobs.c.state).where(_is_claimed(claimed))).scalar_one_or_none()
    if state is None:
        raise _fenced(claimed.job.id, claimed.attempt)
    return bool(state == JobState.CANCELING)


@retry_while_unavailable
def should_yield(store: Store, claimed: Claim) -> bool:
    """Return whether this job has low priority and another has waited so long that all workers must be busy."""
    if claimed.job.priority != "low":
        return False
    busy_s = 1.0
    first = queues_of(claimed.job.queue.removesuffix("-low"))[:-1]
    waits = t.jobs.c.queue.in_(first) & (t.outbox.c.created_at < store.clock() - busy_s)
    query = sa.select(t.jobs.c.id).join(t.outbox, t.outbox.c.job_id == t.jobs.c.id).where(waits).limit(1)
    with store.reading() as connection:
        return connection.execute(query).one_or_none() is not None


@retry_while_unavailable
def start_stage(store: Store, claimed: Claim, stage: JobType) -> None:
    """Mark a stage as running."""
    now = store.clock()
    with store.writing() as connection:
        _touch(connection, claimed)
        row = (t.stages.c.job_id == claimed.job.id) & (t.stages.c.name == stage)
        values = {"state": "running", "progress": 0.0, "started_at": now}
        connection.execute(t.stages.update().where(row).values(**values))


@retry_while_unavailable
def report_progress(
    store: Store, claimed: Claim, stage: JobType, progress: float, *, worked_s: float | None = None
) -> None:
    """Store the progress of a stage, a share in [0, 1].

    A stage that continues an earlier attempt passes its total work time; its start is moved back accordingly.
    """
    values: dict[str, object] = {"progress": min(max(progress, 0.0), 1.0)}
    if worked_s is not None:
        begun, column = store.clock() - worked_s, t.stages.c.started_at
        values["started_at"] = sa.case((column > begun + 1, begun), else_=column)
    with store.writing() as connection:
        _touch(connection, claimed)
        row = (t.stages.c.job_id == claimed.job.id) & (t.stages.c.name == stage) & (t.stages.c.state == "running")
        connection.execute(t.stages.update().where(row).values(**values))


@retry_while_unavailable
def publish_stage(
    store: Store,
    claimed: Claim,
    stage: JobType,
    files: tuple[OutputFile, ...],
    *,
    key: str,
    cached: bool,
    retention_s: float,
) -> None:
    """Publish a stage's files and cache them for other jobs."""
    now = store.clock()
    with store.writing() as connection:
        _touch(connection, claimed)
        row_of = (t.stages.c.job_id == claimed.job.id) & (t.stages.c.name == stage)
        current = connection.execute(sa.select(t.stages.c.state, t.stages.c.started_at).where(row_of)).one()
        if current.state == "succeeded":
            return  # repeated, because the answer to the first commit was lost
        _replace_artifacts(connection, claimed, stage, files, whole_stage=True, now=now, retention_s=retention_s)
        entry = {"key": key, "stage": stage, "files": [asdict(file) for file in files], "used_at": now}
        upsert(connection, t.stage_cache, entry)
        done = {"state": "succeeded", "progress": 1.0, "cached": cached, "finished_at": now}
        connection.execute(t.stages.update().where(row_of).values(**done))
        count(connection, "stages", f"{stage}:{'cached' if cached else 'run'}")
        count(connection, "stage_bytes", stage, sum(file.bytes for file in files))
        if not cached and current.started_at is not None:
            count_seconds(connection, "stage_seconds", stage, now - current.started_at)


@retry_while_unavailable
def publish(store: Store, claimed: Claim, stage: JobType, files: tuple[OutputFile, ...], *, retention_s: float) -> None:
    """Publish files of a stage that is running or has failed; later files replace those of the same name.

    This neither finishes the stage nor caches the files.
    """
    with store.writing() as connection:
        _touch(connection, claimed)
        now = store.clock()
        _replace_artifacts(connection, claimed, stage, files, whole_stage=False, now=now, retention_s=retention_s)


@retry_while_unavailable
def cached_stage(store: Store, key: str) -> tuple[OutputFile, ...] | None:
    """Return the cached files of this key; None if there are none."""
    with store.reading() as connection:
        files = connection.execute(
            sa.select(t.stage_cache.c.files).where(t.stage_cache.c.key == key)
        ).scalar_one_or_none()
    return None if files is None else tuple(OutputFile(**file) for file in files if not file.get("source"))


@retry_while_unavailable
def touch_blob(store: Store, sha256: str, num_bytes: int) -> None:
    """Mark bytes as about to be referenced, so that retention spares them for an hour."""
    with store.writing() as connection:
        upsert(connection, t.blobs, {"sha256": sha256, "bytes": num_bytes, "touched_at": store.clock()})


@retry_while_unavailable
def succeed(store: Store, claimed: Claim) -> JobState:
    """End the attempt with success, or as canceled if a cancel came first; return the final state."""
    return _end(store, claimed, JobState.SUCCEEDED)


@retry_while_unavailable
def fail(store: Store, claimed: Claim, *, code: str, message: str) -> JobState:
    """End the attempt with an error, or as canceled if a cancel came first; return the final state."""
    return _end(store, claimed, JobState.FAILED, error_code=code, error_message=message)


@retry_while_unavailable
def finish_cancel(store: Store, claimed: Claim) -> None:
    """End the attempt as canceled."""
    _end(store, claimed, JobState.CANCELED)


@retry_while_unavailable
def release_attempt(store: Store, claimed: Claim) -> None:
    """Release the job for another worker, without counting the attempt as lost."""
    with store.writing() as connection:
        if _touch(connection, claimed) == JobState.CANCELING:
            end_job(connection, claimed.job.id, JobState.CANCELED, now=store.clock())
            return
        begin_next_attempt(connection, claimed.job.id, claimed.attempt, now=store.clock())
        count(connection, "attempts", "handed-back")


@retry_while_unavailable
def add_usage(store: Store, claimed: Claim, *, processor_s: float, gpu_s: float) -> None:
    """Add an attempt's resource use to its job and to its owner's month, however it ended."""
    month = datetime.fromtimestamp(store.clock(), UTC).strftime("%Y-%m")
    with store.writing() as connection:
        spent = {"processor_s": t.jobs.c.processor_s + processor_s, "gpu_s": t.jobs.c.gpu_s + gpu_s}
        connection.execute(t.jobs.update().where(t.jobs.c.id == claimed.job.id).values(**spent))
        whose = {"owner": claimed.job.owner, "month": month}
        insert_or_add(connection, t.usage, whose, attempts=1, processor_s=processor_s, gpu_s=gpu_s)


@retry_while_unavailable
def forgive_loss(store: Store, job_id: str) -> None:
    """Remove one counted loss: the worker of the reaped attempt was only paused and has not crashed."""
    with store.writing() as connection:
        this = (t.jobs.c.id == job_id) & t.jobs.c.state.in_([JobState.RUNNING, JobState.CANCELING])
        row = connection.execute(sa.select(t.jobs.c.lost_stages).where(this).with_for_update()).one_or_none()
        if row is not None and row.lost_stages:
            connection.execute(t.jobs.update().where(this).values(lost_stages=row.lost_stages[:-1]))


def begin_next_attempt(
    connection: sa.Connection, job_id: str, attempt: int, *, now: float, lost_stages: Sequence[str | None] | None = None
) -> None:
    """Increment the attempt, which fences off the old one, and put the message for the next into the outbox.

    `lost_stages` are the stages in which workers were lost, including this one; None means a hand-back.
    """
    changes: dict[str, object] = {} if lost_stages is None else {"lost_stages": lost_stages}
    changes |= {"attempt": attempt + 1, "lease_owner": None, "lease_until": None, "version": t.jobs.c.version + 1}
    this = (t.jobs.c.id == job_id) & (t.jobs.c.attempt == attempt)
    connection.execute(t.jobs.update().where(this).values(**changes))
    running = (t.stages.c.job_id == job_id) & (t.stages.c.state == "running")
    connection.execute(t.stages.update().where(running).values(state="queued", progress=0.0))
    connection.execute(t.outbox.insert().values(job_id=job_id, attempt=attempt + 1, created_at=now))


def _replace_artifacts(
    connection: sa.Connection,
    claimed: Claim,
    stage: JobType,
    files: tuple[OutputFile, ...],
    *,
    whole_stage: bool,
    now: float,
    retention_s: float,
) -> None:
    """Replace files of the same names; with `whole_stage`, replace all files that the stage offered.

    An unchanged file keeps its id, since clients may have it.
    """
    there = connection.execute(sa.select(t.artifacts).where(t.artifacts.c.job_id == claimed.job.id)).all()
    if files and not there:
        queue_deliveries(connection, claimed.job.id, FIRST_ARTIFACT, now=now)
    wanted, names = {(file.name, file.sha256) for file in files}, {file.name for file in files}
    stale = [
        row.id
        for row in there
        if (row.name, row.sha256) not in wanted and (row.name in names or (whole_stage and row.stage == stage))
    ]
    connection.execute(t.artifacts.delete().where(t.artifacts.c.id.in_(stale)))
    stored = {(row.name, row.sha256) for row in there}
    for file in files:
        if (file.name, file.sha256) not in stored:
            row = {"id": new_id(), "job_id": claimed.job.id, "stage": stage}
            times = {"created_at": now, "expires_at": now + retention_s}
            connection.execute(t.artifacts.insert().values(**row, **times, **asdict(file)))


def _end(store: Store, claimed: Claim, target: JobState, **error: str) -> JobState:
    with store.writing() as connection:
        if _touch(connection, claimed) == JobState.CANCELING:
            target, error = JobState.CANCELED, {}
        end_job(connection, claimed.job.id, target, now=store.clock(), **error)
        return target


def _is_claimed(claimed: Claim) -> sa.ColumnElement[bool]:
    return _running_attempt(claimed.job.id, claimed.attempt, claimed.owner)


def _running_attempt(job_id: str, attempt: int, owner: str) -> sa.ColumnElement[bool]:
    mine = (t.jobs.c.id == job_id) & (t.jobs.c.attempt == attempt) & (t.jobs.c.lease_owner == owner)
    return mine & t.jobs.c.state.in_([JobState.RUNNING, JobState.CANCELING])


def _touch(connection: sa.Connection, claimed: Claim) -> JobState:
    """Increment the job's version and return its state."""
    change = t.jobs.update().where(_is_claimed(claimed)).values(version=t.jobs.c.version + 1)
    state = connection.execute(change.returning(t.jobs.c.state)).scalar_one_or_none()
    if state is None:
        raise _fenced(claimed.job.id, claimed.attempt)
    return JobState(state)


def _fenced(job_id: str, attempt: int) -> FencedError:
    return FencedError(f"attempt {attempt} of job {job_id} is no longer ours; another one began, or the job ended")
