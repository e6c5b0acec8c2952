"""What somebody has to do every second: send messages, take jobs from the dead, forget what is old.

`python -m worker.housekeeper`. Many may run; the one that holds the lease acts.
"""

import logging
import os
import shutil
import signal
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import redis
import sqlalchemy as sa
from celery import Celery
from kombu.exceptions import OperationalError

from jobs.artifacts import ArtifactStore, open_artifacts
from jobs.errors import StorageAwayError
from jobs.logging_setup import set_up_logging
from jobs.maintenance import (
    HOUSEKEEPER_LEASE,
    abort_overdue,
    forget_blob,
    forget_deliveries,
    forget_expired,
    hold_lease,
    mark_sent,
    reap,
    release_lease,
    unclaimed,
    unreferenced_blobs,
    unsent,
)
from jobs.messages import RUN_JOB, RunJob
from jobs.settings import Settings, read_settings
from jobs.store import Store
from jobs.upload_parts import PartStore, open_parts
from jobs.uploads import bury, expired_uploads
from worker.courier import Courier

logger = logging.getLogger(__name__)

SCRATCH_AGE_S = 86400.0
REDIS_TIMEOUT_S = 2.0
AWAY_PAUSE_S = 1.0
AWAY = (sa.exc.SQLAlchemyError, OperationalError, redis.RedisError, StorageAwayError, OSError)
"""What may be away for a while. The duty is done at its next turn."""


@dataclass(frozen=True, kw_only=True)
class Housekeeper:
    """The duties, and what they need."""

    settings: Settings
    store: Store
    artifacts: ArtifactStore
    parts: PartStore
    queue: Celery
    redis: redis.Redis

    def send(self) -> None:
        """Send what no worker was told yet."""
        for message in unsent(self.store):
            self._send(message)

    def send_again(self) -> None:
        """Send what was lost with the queue: told long ago, not begun, and no longer in there."""
        for message in unclaimed(self.store, sent_before=self.store.clock() - self.settings.resend_s):
            if self.redis.llen(message.queue) == 0:
                logger.warning("message for job %s was lost; sent again", message.job_id)
                self._send(message)

    def reap(self) -> None:
        """Take jobs from workers that are gone, and end those that nobody began in time."""
        for job_id, state in reap(self.store, max_lost_attempts=self.settings.max_lost_attempts):
            logger.warning("job %s was left by its worker; it is %s now", job_id, state)
        abort_overdue(self.store)

    def forget(self) -> None:
        """Drop what is past its time, and bytes that nothing refers to."""
        settings = self.settings
        forget_expired(
            self.store, job_retention_s=settings.job_retention_s, cache_retention_s=settings.artifact_retention_s
        )
        forget_deliveries(self.store, retention_s=settings.webhook_retention_s)
        for upload_id in expired_uploads(self.store):
            self.parts.delete(upload_id)
            bury(self.store, upload_id)
        for digest in unreferenced_blobs(self.store):
            forget_blob(self.store, digest, self.artifacts.delete)
        if settings.scratch_dir.is_dir():
            for left in settings.scratch_dir.iterdir():
                if time.time() - left.stat().st_mtime > SCRATCH_AGE_S:
                    shutil.rmtree(left, ignore_errors=True)

    def _send(self, message: RunJob) -> None:
        self.queue.send_task(RUN_JOB, args=message.args, queue=message.queue, retry=False)
        mark_sent(self.store, message)


def open_housekeeper(settings: Settings) -> Housekeeper:
    """Connect to store, bytes and queue."""
    from worker.app import make_app

    queue = make_app(settings)
    # a Redis that is away must not keep the other duties waiting, nor the lease
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


@dataclass(kw_only=True)
class Turn:
    """A duty, and when it comes again."""

    duty: Callable[[], None]
    every_s: float
    due: float = 0.0

    def take(self, now: float) -> None:
        """Do the duty if it is due; soon again where something was away."""
        if now >= self.due:
            self.due = now + (self.every_s if _done(self.duty) else max(self.every_s, AWAY_PAUSE_S))


def run(keeper: Housekeeper, stopped: threading.Event) -> None:
    """Do every duty in its turn, while the lease is ours, until stopped."""
    settings, owner = keeper.settings, f"{socket.gethostname()}:{os.getpid()}"
    reaping = Turn(duty=keeper.reap, every_s=settings.reaper_interval_s)
    turns = (
        Turn(duty=keeper.send, every_s=settings.outbox_interval_s),
        reaping,
        Turn(duty=keeper.send_again, every_s=min(settings.resend_s, 5.0)),
        Turn(duty=keeper.forget, every_s=settings.retention_interval_s),
    )
    lease_s = settings.housekeeper_lease_s
    ours, renew_at = False, 0.0
    while not stopped.wait(settings.outbox_interval_s):
        now = time.monotonic()
        if now >= renew_at:
            ours = _done(lambda: hold_lease(keeper.store, HOUSEKEEPER_LEASE, owner=owner, lease_s=lease_s))
            renew_at = now + lease_s / 3
            if not ours:
                reaping.due = now + 2 * settings.heartbeat_s  # where the store was away, leases could not be renewed
        if ours:
            for turn in turns:
                turn.take(now)
    _done(lambda: release_lease(keeper.store, HOUSEKEEPER_LEASE, owner=owner))


def _done(duty: Callable[[], bool | None]) -> bool:
    """Do it, and tell whether it could be done; what is away will be there again."""
    try:
        return duty() is not False
    except AWAY as error:
        logger.warning("something is away, the housekeeper tries again: %s: %s", type(error).__name__, error)
        return False


def main() -> None:
    """Run until SIGTERM or SIGINT."""
    settings = read_settings()
    set_up_logging(settings)
    stopped = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopped.set())
    keeper = open_housekeeper(settings)
    courier = threading.Thread(target=Courier(keeper.store, settings).run, args=(stopped,), name="courier")
    courier.start()
    run(keeper, stopped)
    courier.join()


if __name__ == "__main__":
    main()
