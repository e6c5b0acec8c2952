"""Periodic duties: send messages, reap expired leases, delete expired data.

`python -m worker.housekeeper`. Many may run; the one that holds the lease acts.
"""

import logging
import os
import shutil
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import redis
import sqlalchemy as sa
from celery import Celery
from kombu.exceptions import OperationalError

from jobs.errors import ConflictError, GoneError, NotFoundError, StorageAwayError
from jobs.lifecycle import maintenance
from jobs.lifecycle.maintenance import HOUSEKEEPER_LEASE, RUN_JOB, WORKER_LEASES, RunJob, hold_lease, lease_names
from jobs.logging_setup import set_up_logging
from jobs.settings import Settings, read_settings
from jobs.states import AUTO
from jobs.storage.artifacts import ArtifactStore, open_artifacts
from jobs.storage.assets import read_asset
from jobs.storage.backup import BACKUP_LEASE
from jobs.storage.disk import free_bytes
from jobs.storage.references import forget_blob, unreferenced_blobs
from jobs.storage.stage_files import HALF_DONE
from jobs.storage.upload_parts import PartStore, open_parts
from jobs.storage.uploads import delete_upload, expired_uploads
from jobs.store import Store
from worker.courier import Courier
from worker.half_done import discard

logger = logging.getLogger(__name__)
Item = TypeVar("Item")

SCRATCH_AGE_S = 86400.0
QUEUE_WINDOW = 2
"""Messages in the queue beyond one per worker, so that no worker waits for the housekeeper."""

DELETION_LIMIT_S = 0.5
"""Longest time that one turn deletes bytes [s], since messages and the lease wait; the next turn follows at once."""

DELETION_BATCH = 1000
"""Number of items to delete that one query returns."""

MAX_FAILURES = 5
"""Deletions that may fail in one turn before the storage counts as unavailable."""

COURIER_SILENCE_S = 120.0
"""Time without a look for deliveries after which the courier counts as hung [s]."""

RESERVE_BYTES = 64 * 1024**2
"""Size of the reserve; enough for SQLite's log and Redis's file during many turns of retention."""

REDIS_TIMEOUT_S = 2.0
RETRY_S = 1.0
CONNECTION_ERRORS = (sa.exc.SQLAlchemyError, OperationalError, redis.RedisError, StorageAwayError, OSError)
"""Errors of services that may be unavailable for a while. The duty is retried at its next turn."""


@dataclass(frozen=True, kw_only=True)
class Housekeeper:
    """Periodic duties and their connections."""

    settings: Settings
    store: Store
    artifacts: ArtifactStore
    parts: PartStore
    queue: Celery
    redis: redis.Redis
    unreferenced: deque[str] = field(default_factory=deque)  # hashes of bytes to delete

    def send(self) -> None:
        """Send messages of waiting jobs, up to the window that workers will soon take."""
        window = len(lease_names(self.store, WORKER_LEASES)) + QUEUE_WINDOW
        for message in maintenance.messages_to_send(self.store, window=window):
            self._send(message)

    def send_again(self) -> None:
        """Send lost messages again: sent long ago, not started, and no longer in the queue."""
        messages = maintenance.unclaimed_messages(self.store, sent_before=self.store.clock() - self.settings.resend_s)
        empty = {queue for queue in {message.queue for message in messages} if self.redis.llen(queue) == 0}
        for message in messages:
            if message.queue in empty:
                logger.warning("message for job %s was lost; sent again", message.job_id)
                self._send(message)

    def reap(self) -> None:
        """Reclaim jobs of dead workers, and cancel overdue jobs."""
        for job_id, state in maintenance.end_expired(self.store, max_lost_attempts=self.settings.max_lost_attempts):
            logger.warning("job %s was left by its worker; it is %s now", job_id, state)
        for job_id in maintenance.overdue_jobs(self.store):
            with suppress(ConflictError):  # the job has ended meanwhile
                self.store.cancel(job_id)
        if self.settings.queue == AUTO:
            maintenance.reroute(self.store)

    def forget(self) -> float | None:
        """Delete expired records and unreferenced bytes; return 0 if the time was too short, else None."""
        settings, until = self.settings, time.monotonic() + DELETION_LIMIT_S
        maintenance.delete_expired(self.store, settings)
        finished = _for_each(expired_uploads(self.store, limit=DELETION_BATCH), self._forget_upload, until)
        if finished and not lease_names(self.store, BACKUP_LEASE):  # a backup needs bytes of rows that may be gone
            finished = self._forget_blobs(until)
        if finished and settings.scratch_dir.is_dir():
            finished = _for_each(settings.scratch_dir.iterdir(), self._forget_scratch, until)
        return None if finished else 0.0

    def _forget_blobs(self, until: float) -> bool:
        """Delete unreferenced bytes, first those that an earlier turn found: the query takes 1 s for 200,000 blobs."""
        looked = not self.unreferenced
        if looked:
            self.unreferenced.extend(unreferenced_blobs(self.store, limit=DELETION_BATCH))
        full = looked and len(self.unreferenced) == DELETION_BATCH
        taken = (self.unreferenced.popleft() for _ in range(len(self.unreferenced)))
        tried = _for_each(taken, lambda digest: forget_blob(self.store, digest, self.artifacts.delete), until)
        return looked and tried and not full

    def _forget_upload(self, upload_id: str) -> None:
        self.parts.delete(upload_id)
        delete_upload(self.store, upload_id)

    def _forget_scratch(self, left: Path) -> None:
        """Delete scratch files after a day, and half-done work also if its asset is deleted or the disk is full."""
        old = time.time() - left.stat().st_mtime > SCRATCH_AGE_S
        if left.name.startswith(HALF_DONE) and left.is_dir():
            if old or free_bytes(self.settings) < self.settings.min_free_bytes or not self._has_asset(left):
                discard(left)
        elif old and left.is_dir() and not left.is_symlink():
            shutil.rmtree(left)
        elif old:
            left.unlink(missing_ok=True)

    def _has_asset(self, half_done: Path) -> bool:
        try:
            read_asset(self.store, half_done.name.removeprefix(HALF_DONE).partition("-")[0])
        except (NotFoundError, GoneError):
            return False
        return True

    def _send(self, message: RunJob) -> None:
        self.queue.send_task(RUN_JOB, args=message.args, queue=message.queue, retry=False)
        maintenance.mark_sent(self.store, message)


def _for_each(things: Iterable[Item], remove: Callable[[Item], None], until: float) -> bool:
    """Delete items one by one until a deadline; a failure does not stop the others. Return whether all were tried."""
    failed = 0
    for thing in things:
        if time.monotonic() >= until:
            return False
        try:
            remove(thing)
        except (StorageAwayError, OSError) as error:
            logger.warning("%s cannot be removed now: %s", thing, error)
            failed += 1
            if failed == MAX_FAILURES:  # the storage is unavailable
                raise
    return True


def open_housekeeper(settings: Settings) -> Housekeeper:
    """Connect to store, bytes and queue."""
    from worker.app import make_app

    queue = make_app(settings)
    # an unavailable Redis must not delay the other duties or the lease
    once = {"max_retries": 1, "interval_start": 0, "interval_step": 0, "interval_max": 0}
    queue.conf.broker_transport_options |= once | {"socket_timeout": REDIS_TIMEOUT_S}
    return Housekeeper(
        settings=settings,
        store=Store.open(settings.resolved_database_url),
        artifacts=open_artifacts(settings.resolved_artifacts_url, credentials=settings.s3_credentials),
        parts=open_parts(settings.resolved_artifacts_url, credentials=settings.s3_credentials),
        queue=queue,
        redis=redis.Redis.from_url(
            settings.resolved_redis_url, socket_timeout=REDIS_TIMEOUT_S, socket_connect_timeout=REDIS_TIMEOUT_S
        ),
    )


class PauseDetector:
    """Detects that this process was paused or the clock was set: leases may have expired without a crash."""

    def __init__(
        self, *, longest_s: float, wall: Callable[[], float] = time.time, steady: Callable[[], float] = time.monotonic
    ) -> None:
        self.longest_s = longest_s
        self._clocks = (wall, steady)  # the steady clock of a suspended machine stops; the wall clock continues
        self._last = (wall(), steady())

    def detect(self) -> bool:
        """Return whether either clock moved by more than `longest_s`, or back, since the last call."""
        now = (self._clocks[0](), self._clocks[1]())
        moved = [after - before for after, before in zip(now, self._last, strict=True)]
        self._last = now
        if stood_still := not all(-0.5 <= seconds <= self.longest_s for seconds in moved):
            logger.warning("a pause or a clock step of %.1f s; leases are given time", max(moved, key=abs))
        return stood_still


class DiskReserve:
    """A file that is deleted when the disk is full, so that the database can write and retention can free space."""

    def __init__(self, folder: Path, reserve_bytes: int = RESERVE_BYTES) -> None:
        self.path = folder / "disk-reserve"
        self.reserve_bytes = reserve_bytes

    def balance(self) -> None:
        """Delete the reserve if the disk is full; create it again once four times its size is free."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(self.path.parent).free
        there = self.path.exists()
        if there and free < self.reserve_bytes // 4:
            self.path.unlink()
            logger.error("the disk is full; %s bytes of reserve were given up for retention", self.reserve_bytes)
        elif not there and free > 4 * self.reserve_bytes:
            beside = self.path.with_suffix(".part")
            with beside.open("wb") as stream:
                os.posix_fallocate(stream.fileno(), 0, self.reserve_bytes)
            beside.rename(self.path)


@dataclass(kw_only=True)
class ScheduledDuty:
    """A duty and its next due time. The duty may return the seconds to its next turn in place of the usual interval."""

    duty: Callable[[], float | None]
    every_s: float
    due: float = 0.0

    def take(self, now: float) -> None:
        """Run the duty if it is due; retry soon if a service did not respond."""
        if now >= self.due:
            try:
                pause_s = self.duty()
            except CONNECTION_ERRORS as error:
                _warn(error)
                pause_s = max(self.every_s, RETRY_S)
            self.due = now + (self.every_s if pause_s is None else pause_s)


def run(keeper: Housekeeper, stopped: threading.Event, *, works: Callable[[], bool] = lambda: True) -> None:
    """Run every duty when due, while this process has the lease, until `stopped` is set or `works` returns False."""
    settings, owner = keeper.settings, f"{socket.gethostname()}:{os.getpid()}"
    reaping = ScheduledDuty(duty=keeper.reap, every_s=settings.reaper_interval_s)
    turns = (
        ScheduledDuty(duty=keeper.send, every_s=settings.outbox_interval_s),
        reaping,
        ScheduledDuty(duty=keeper.send_again, every_s=min(settings.resend_s, 5.0)),
        ScheduledDuty(duty=keeper.forget, every_s=settings.retention_interval_s),
    )
    lease_s = settings.housekeeper_lease_s
    pauses = PauseDetector(longest_s=(settings.lease_s - settings.heartbeat_s) / 2)
    ours, renew_at = False, 0.0
    reserve = ScheduledDuty(duty=DiskReserve(settings.state_dir.resolve()).balance, every_s=1.0)
    while works() and not stopped.wait(settings.outbox_interval_s):
        now = time.monotonic()
        reserve.take(now)  # comes before the lease, which cannot be written to a full disk
        if now >= renew_at:
            if settings.worker_alive_file is not None:
                settings.worker_alive_file.touch()
            ours = _run_duty(lambda: hold_lease(keeper.store, HOUSEKEEPER_LEASE, owner=owner, lease_s=lease_s))
            renew_at = now + lease_s / 3
            if not ours:
                reaping.due = now + 2 * settings.heartbeat_s  # leases could not be renewed without the store
        if ours:
            for turn in turns:
                if pauses.detect():  # workers were paused too; they renew with their next heartbeat
                    reaping.due = time.monotonic() + 2 * settings.heartbeat_s
                turn.take(time.monotonic())
    _run_duty(lambda: maintenance.release_lease(keeper.store, HOUSEKEEPER_LEASE, owner=owner))


def _run_duty(duty: Callable[[], bool | None]) -> bool:
    """Run a duty; return False if a service did not respond."""
    try:
        return duty() is not False
    except CONNECTION_ERRORS as error:
        _warn(error)
        return False


def _warn(error: Exception) -> None:
    logger.warning("something is away, the housekeeper tries again: %s: %s", type(error).__name__, error)


def main() -> None:
    """Run until SIGTERM or SIGINT."""
    settings = read_settings()
    set_up_logging(settings)
    stopped = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopped.set())
    keeper = open_housekeeper(settings)
    sys.exit(run_all(keeper, Courier(keeper.store, settings), stopped))


def run_all(keeper: Housekeeper, courier: Courier, stopped: threading.Event) -> int:
    """Run housekeeper and courier until stopped; return 1 if the courier died or hangs, so that both restart."""
    thread = threading.Thread(target=courier.run, args=(stopped,), name="courier", daemon=True)
    thread.start()

    def works() -> bool:
        return thread.is_alive() and time.monotonic() - courier.looked_at < COURIER_SILENCE_S

    try:
        run(keeper, stopped, works=works)
    finally:  # the courier must not keep the process alive after an error
        intended = stopped.is_set()
        stopped.set()
    if intended:
        thread.join(keeper.settings.webhook_timeout_s + 1)
        return 0
    logger.critical("the courier %s", "hangs" if thread.is_alive() else "died")
    return 1


if __name__ == "__main__":
    main()
