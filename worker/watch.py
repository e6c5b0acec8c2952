"""Keeps an attempt ours while it runs, and stops it when it should stop."""

import logging
import threading
import time
from collections.abc import Callable
from types import TracebackType

import sqlalchemy as sa

from dynamictree.errors import Cancelled
from jobs.attempts import canceling, renew, report_progress
from jobs.errors import FencedError
from jobs.records import Claim
from jobs.states import JobType
from worker.runtime import Runtime

logger = logging.getLogger(__name__)


class HandedBack(Exception):
    """The worker was asked to stop; another one is to begin the next attempt."""


class Watch:
    """A heartbeat thread for one attempt, and the question that every step asks."""

    def __init__(self, here: Runtime, held: Claim, *, stopping: Callable[[], bool]) -> None:
        self.here = here
        self.held = held
        self._stopping = stopping
        self._done = threading.Event()
        self._lost = threading.Event()
        self._reported_at = 0.0
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._done.set()
        self._thread.join()

    def check(self) -> None:
        """Go on, or not.

        Raises:
            Cancelled: someone asked the job to stop.
            FencedError: the attempt is no longer ours.
            HandedBack: this worker is to stop.
        """
        if self._lost.is_set():
            raise FencedError(f"the lease of attempt {self.held.attempt} of job {self.held.job.id} was lost")
        if canceling(self.here.store, self.held):
            raise Cancelled(f"job {self.held.job.id} was asked to stop")
        if self._stopping():
            raise HandedBack(f"the worker stops; job {self.held.job.id} goes to another")

    def report(self, stage: JobType, progress: float) -> None:
        """Ask whether to go on, and tell how much of a stage is done, the latter not too often."""
        self.check()
        now = time.monotonic()
        if now - self._reported_at >= self.here.settings.progress_interval_s:
            report_progress(self.here.store, self.held, stage, progress)
            self._reported_at = now

    def _beat(self) -> None:
        while not self._done.wait(self.here.settings.heartbeat_s):
            try:
                renew(self.here.store, self.held, lease_s=self.here.settings.lease_s)
            except FencedError:
                self._lost.set()
                return
            except sa.exc.SQLAlchemyError:
                # the lease runs on for a while; if the database stays away, the reaper decides
                logger.warning("the lease could not be renewed", exc_info=True)
