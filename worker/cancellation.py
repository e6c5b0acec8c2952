"""Cancellation check, called between steps, while a heartbeat renews the lease."""

import time
from collections.abc import Callable
from types import TracebackType

from dynamictree.errors import Cancelled
from jobs.attempts import canceling, report_progress
from jobs.records import Claim
from jobs.states import JobType
from worker.runtime import Runtime


class HandedBack(Exception):
    """The worker was asked to stop; another one is to begin the next attempt."""


class Watch:
    """A heartbeat for one attempt, and the question that every step asks."""

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
        """Go on, or not.

        Raises:
            Cancelled: someone asked the job to stop.
            FencedError: the attempt is no longer ours.
            HandedBack: this worker is to stop.
        """
        if canceling(self.resources.store, self.claimed):
            raise Cancelled(f"job {self.claimed.job.id} was asked to stop")
        if self._stopping():
            raise HandedBack(f"the worker stops; job {self.claimed.job.id} goes to another")

    def report(self, stage: JobType, progress: float) -> None:
        """Ask whether to go on, and tell how much of a stage is done, the latter not too often."""
        self.check()
        now = time.monotonic()
        if now - self._reported_at >= self.resources.settings.progress_interval_s:
            report_progress(self.resources.store, self.claimed, stage, progress)
            self._reported_at = now
