"""The housekeeper's changes to the store: messages to send, expired leases, deadlines, retention."""

from collections import Counter
from typing import NamedTuple

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.database.counters import count
from jobs.database.engine import upsert
from jobs.lifecycle.attempts import begin_next_attempt
from jobs.lifecycle.rows import delete_with_tombstones, end_job
from jobs.settings import Settings
from jobs.states import CPU, GPU, JobState, queues_of
from jobs.store import Store

TOMBSTONE_S = 90 * 86400.0
"""Time for which the id of a deleted job or upload is remembered [s]: status 410, not 404."""

WORKER_LEASES = "worker:"
"""Prefix of the name of every worker's lease."""

REROUTE_S = 60.0
"""Time that a job waits for a worker of its own queue before the other queue may take it [s]; workers may restart."""

HOUSEKEEPER_LEASE = "housekeeper"

RUN_JOB = "dynamictree.run_job"


class RunJob(NamedTuple):
    """Message to a worker: one attempt of a job. Workers read everything else from the store."""

    job_id: str
    attempt: int
    queue: str

    @property
    def args(self) -> tuple[str, int]:
        """Return the arguments of the Celery task."""
        return self[:2]


def hold_lease(store: Store, name: str, *, owner: str, lease_s: float) -> bool:
    """Acquire or renew a named lease, so that only one process acts; return whether `owner` has it."""
    now = store.clock()
    free = (t.leases.c.owner == owner) | (t.leases.c.until <= now)
    with store.writing() as connection:
        return upsert(connection, t.leases, {"name": name, "owner": owner, "until": now + lease_s}, only_if=free)


def release_lease(store: Store, name: str, *, owner: str) -> None:
    """Release a named lease at once."""
    with store.writing() as connection:
        connection.execute(t.leases.delete().where((t.leases.c.name == name) & (t.leases.c.owner == owner)))


def lease_names(store: Store, prefix: str) -> list[str]:
    """Return the names of current leases with this prefix."""
    active = t.leases.c.name.startswith(prefix, autoescape=True) & (t.leases.c.until > store.clock())
    with store.reading() as connection:
        return list(connection.execute(sa.select(t.leases.c.name).where(active)).scalars())


def worker_lease(queue: str, owner: str) -> str:
    """Return the name of the lease by which a worker of a queue reports its presence."""
    return f"{WORKER_LEASES}{queue}:{owner}"


def is_served(store: Store, queue: str) -> bool:
    """Return whether a queue has a worker."""
    return bool(lease_names(store, worker_lease(queue, "")))


def reroute(store: Store) -> int:
    """Move jobs from a queue without workers to the other one, if that has some; return their number."""
    served = {queue: is_served(store, queue) for queue in (CPU, GPU)}
    if sum(served.values()) != 1:
        return 0
    left, to = (GPU, CPU) if served[CPU] else (CPU, GPU)
    free = t.jobs.c.state.in_([JobState.QUEUED, JobState.RUNNING]) & t.jobs.c.lease_owner.is_(None)
    waiting = free & (t.jobs.c.created_at < store.clock() - REROUTE_S)
    moved = 0
    with store.writing() as connection:
        for old, new in zip(queues_of(left), queues_of(to), strict=True):
            these = sa.select(t.jobs.c.id).where(waiting & (t.jobs.c.queue == old))
            ids = list(connection.execute(these).scalars())
            if ids:
                connection.execute(t.outbox.update().where(t.outbox.c.job_id.in_(ids)).values(sent_at=None))
                changes = {"queue": new, "version": t.jobs.c.version + 1}
                connection.execute(t.jobs.update().where(t.jobs.c.id.in_(ids)).values(**changes))
            moved += len(ids)
    return moved


def messages_to_send(store: Store, *, window: int) -> list[RunJob]:
    """Return the messages to send now: at most `window` unclaimed ones per queue, owners in turn.

    The queue in Redis is first in, first out; fairness comes from keeping it short. The next message is that of the
    owner with the fewest jobs running or sent; among equals, the oldest.
    """
    jobs, outbox = t.jobs, t.outbox
    is_sent = outbox.c.sent_at.is_not(None)
    place = sa.func.row_number().over(partition_by=(jobs.c.queue, jobs.c.owner), order_by=outbox.c.created_at)
    columns = (outbox.c.job_id, outbox.c.attempt, outbox.c.created_at, jobs.c.queue, jobs.c.owner, place.label("place"))
    waiting = sa.select(*columns).join(jobs, jobs.c.id == outbox.c.job_id).where(~is_sent).subquery()
    with store.reading() as connection:
        if connection.execute(sa.select(outbox.c.job_id).where(~is_sent).limit(1)).one_or_none() is None:
            return []
        sent = sa.select(jobs.c.queue, jobs.c.owner).join(outbox, jobs.c.id == outbox.c.job_id).where(is_sent)
        out = [(row.queue, row.owner) for row in connection.execute(sent)]
        active = sa.select(jobs.c.owner).where((jobs.c.state == JobState.RUNNING) & jobs.c.lease_owner.is_not(None))
        busy = Counter([*connection.execute(active).scalars(), *(owner for _, owner in out)])
        rows = connection.execute(sa.select(waiting).where(waiting.c.place <= window)).all()
    room = dict.fromkeys({row.queue for row in rows}, window)
    for queue, _ in out:
        room[queue] = room.get(queue, window) - 1
    chosen = []
    for row in sorted(rows, key=lambda row: (row.place + busy[row.owner], row.created_at, row.job_id)):
        if room[row.queue] > 0:
            room[row.queue] -= 1
            chosen.append(RunJob(row.job_id, row.attempt, row.queue))
    return chosen


def unclaimed_messages(store: Store, *, sent_before: float, limit: int = 100) -> list[RunJob]:
    """Return messages that were sent before a time and not claimed by a worker: lost, or still in the queue."""
    query = (
        sa.select(t.outbox.c.job_id, t.outbox.c.attempt, t.jobs.c.queue)
        .join(t.jobs, t.jobs.c.id == t.outbox.c.job_id)
        .where(t.outbox.c.sent_at < sent_before)
        .order_by(t.outbox.c.created_at)
        .limit(limit)
    )
    with store.reading() as connection:
        return [RunJob(row.job_id, row.attempt, row.queue) for row in connection.execute(query)]


def mark_sent(store: Store, message: RunJob) -> None:
    """Record that a message was sent."""
    with store.writing() as connection:
        row = (t.outbox.c.job_id == message.job_id) & (t.outbox.c.attempt == message.attempt)
        connection.execute(t.outbox.update().where(row).values(sent_at=store.clock()))


def end_expired(store: Store, *, max_lost_attempts: int) -> list[tuple[str, JobState]]:
    """End attempts whose lease expired: start the next attempt or fail the job; return id and state."""
    reaped = []
    with store.reading() as connection:
        stale = connection.execute(sa.select(t.jobs.c.id).where(_is_stale(store.clock()))).scalars().all()
    for job_id in stale:
        with store.writing() as connection:
            state = _reap_one(connection, job_id, store.clock(), max_lost_attempts)
        if state is not None:
            reaped.append((job_id, state))
    return reaped


def _is_stale(now: float) -> sa.ColumnElement[bool]:
    return (t.jobs.c.lease_until < now) & t.jobs.c.state.in_([JobState.RUNNING, JobState.CANCELING])


def _reap_one(connection: sa.Connection, job_id: str, now: float, max_lost_attempts: int) -> JobState | None:
    stale = sa.select(t.jobs).where((t.jobs.c.id == job_id) & _is_stale(now)).with_for_update()
    row = connection.execute(stale).one_or_none()
    if row is None:
        return None  # the lease was renewed or the job has ended in the meantime
    if row.state == JobState.CANCELING:
        end_job(connection, job_id, JobState.CANCELED, now=now)
        return JobState.CANCELED
    running = (t.stages.c.job_id == job_id) & (t.stages.c.state == "running")
    stage = connection.execute(sa.select(t.stages.c.name).where(running)).scalar_one_or_none()
    lost = [*row.lost_stages, stage]
    count(connection, "attempts", "lost")
    if len(lost) <= max_lost_attempts:
        begin_next_attempt(connection, job_id, row.attempt, now=now, lost_stages=lost)
        return JobState.RUNNING
    code, message = _loss(lost)
    end_job(connection, job_id, JobState.FAILED, now=now, error_code=code, error_message=message, lost_stages=lost)
    return JobState.FAILED


def _loss(lost: list[str | None]) -> tuple[str, str]:
    if len(set(lost)) == 1 and len(lost) > 1 and lost[0] is not None:
        detail = f"{len(lost)} workers were lost, each in the stage {lost[0]}"
        return "poison-input", f"{detail}; the input likely needs more memory than a worker has; simplify the mesh"
    return "worker-lost", f"{len(lost)} workers were lost while they ran this job; try again"


def overdue_jobs(store: Store) -> list[str]:
    """Return the ids of unfinished jobs whose `cancel_at` has passed."""
    late = t.jobs.c.state.in_([JobState.QUEUED, JobState.RUNNING]) & (t.jobs.c.cancel_at < store.clock())
    with store.reading() as connection:
        return list(connection.execute(sa.select(t.jobs.c.id).where(late)).scalars())


def delete_expired(store: Store, settings: Settings) -> None:
    """Delete expired assets, jobs, cached stages and deliveries; artifacts stay with their job, for status 410."""
    now = store.clock()
    with store.writing() as connection:
        in_use = sa.select(t.jobs.c.asset_id).where(t.jobs.c.finished_at.is_(None))
        old = (t.assets.c.expires_at < now) & t.assets.c.deleted_at.is_(None) & t.assets.c.id.not_in(in_use)
        connection.execute(t.assets.update().where(old).values(deleted_at=now, live_fingerprint=None))
        delete_with_tombstones(connection, t.jobs.c.finished_at < now - settings.job_retention_s, now=now)
        connection.execute(t.tombstones.delete().where(t.tombstones.c.gone_at < now - TOMBSTONE_S))
        connection.execute(t.stage_cache.delete().where(t.stage_cache.c.used_at < now - settings.artifact_retention_s))
        over = (t.deliveries.c.created_at < now - settings.webhook_retention_s) & t.deliveries.c.next_at.is_(None)
        connection.execute(t.deliveries.delete().where(over))
