"""Cancellation check, called between steps, while a heartbeat renews the lease."""

import time
from collections.abc import Callable
from types import TracebackType

from dynamictree.errors import Cancelled
from jobs.errors import StorageFullError
from jobs.lifecycle.attempts import cancel_requested, report_progress, should_yield
from jobs.records import Claim
from jobs.settings import Settings
from jobs.states import JobType
from jobs.storage.disk import free_bytes
from worker.runtime import Runtime


class HandedBack(Exception):
    """The worker was asked to stop, or a more urgent job waits; the next attempt begins later."""


class Watch:
    """Heartbeat of one attempt, and the cancellation check between steps."""

    def __init__(self, resources: Runtime, claimed: Claim, *, stopping: Callable[[], bool]) -> None:
        self.resources = resources
        self.claimed = claimed
        self._stopping = stopping
        self._reported_at = -1e9

    def __enter__(self) -> "Watch":
        self.resources.heartbeat.hold(self.claimed)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.resources.heartbeat.drop()

    def check(self) -> None:
        """Raise if the attempt should stop.

        Raises:
            Cancelled: cancellation of the job was requested.
            FencedError: another attempt owns the job.
            HandedBack: this worker must stop, or this job yields to another.
        """
        if cancel_requested(self.resources.store, self.claimed):
            raise Cancelled(f"job {self.claimed.job.id} was asked to stop")
        if self._stopping():
            raise HandedBack(f"the worker stops; job {self.claimed.job.id} goes to another")
        if should_yield(self.resources.store, self.claimed):
            raise HandedBack(f"job {self.claimed.job.id} has low priority and gives way to one that waits")

    def report(self, stage: JobType, progress: float, worked_s: float | None = None) -> None:
        """Check whether to continue, and report a stage's progress; disk check and report are rate-limited.

        `worked_s` is the time that the stage took so far, with that of earlier attempts.

        Raises:
            Cancelled, FencedError, HandedBack: as in `check`.
            StorageFullError: files of the stage have used half of the disk's reserve.
        """
        self.check()
        now = time.monotonic()
        if now - self._reported_at >= self.resources.settings.progress_interval_s:
            require_free_disk(self.resources.settings)
            report_progress(self.resources.store, self.claimed, stage, progress, worked_s=worked_s)
            self._reported_at = now


def require_free_disk(settings: Settings) -> None:
    """Raise if less than half of `min_free_bytes` is free, which the database needs.

    Raises:
        StorageFullError: less is free.
    """
    free = free_bytes(settings)
    if free < settings.min_free_bytes // 2:
        raise StorageFullError(
            f"the worker's disk has {free:,} bytes left, of {settings.min_free_bytes:,} in reserve; try again later"
        )
