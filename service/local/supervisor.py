"""Supervise child processes: start, restart with backoff, stop in order."""

import ctypes
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

logger = logging.getLogger(__name__)

FIRST_BACKOFF_S = 0.5
MAX_BACKOFF_S = 30.0
STEADY_S = 30.0
"""Run time after which a child's backoff is reset [s]."""

KILL_AFTER_S = 5.0
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None  # loaded before a fork: another thread may own a lock


@dataclass(frozen=True, kw_only=True)
class ChildPlan:
    """Command of a child process, and how it is stopped."""

    name: str
    command: Sequence[str]
    environment: Mapping[str, str]
    pass_fds: tuple[int, ...] = ()
    ready: Callable[[], bool] = field(default=lambda: True)  # polled before the next child is started
    grace_s: float = KILL_AFTER_S  # time from SIGTERM to SIGKILL


class Child:
    """A supervised process."""

    def __init__(self, plan: ChildPlan) -> None:
        self.plan = plan
        self.restarts = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._started_at = 0.0
        self._again_at = 0.0
        self._backoff_s = FIRST_BACKOFF_S

    @property
    def pid(self) -> int | None:
        """Return the process id; None if the process does not run."""
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Start the process in its own process group; it ends with this process."""
        self._process = subprocess.Popen(
            self.plan.command,
            env=dict(self.plan.environment),
            pass_fds=self.plan.pass_fds,
            stdin=subprocess.DEVNULL,
            stdout=sys.stderr.fileno(),
            start_new_session=True,
            preexec_fn=die_with_parent,  # noqa: PLW1509 (the supervisor has no threads)
        )
        self._started_at = time.monotonic()
        logger.info("%s runs as process %s", self.plan.name, self._process.pid)

    def ensure_running(self) -> None:
        """Check the process; restart it after its backoff if it has died."""
        now = time.monotonic()
        if self._process is not None:
            code = self._process.poll()
            if code is None:
                return
            self._end_group()
            self._process = None
            if now - self._started_at > STEADY_S:
                self._backoff_s = FIRST_BACKOFF_S
            logger.error("%s ended with %s; it starts again in %g s", self.plan.name, code, self._backoff_s)
            self._again_at = now + self._backoff_s
            self._backoff_s = min(self._backoff_s * 2, MAX_BACKOFF_S)
        elif now >= self._again_at:
            self.restarts += 1
            self.start()

    def stop(self) -> None:
        """Stop the process: SIGTERM, then SIGKILL after the grace period."""
        if self._process is None:
            return
        self._process.terminate()
        try:
            self._process.wait(self.plan.grace_s)
        except subprocess.TimeoutExpired:
            logger.warning("%s did not end within %g s; killed", self.plan.name, self.plan.grace_s)
        self._end_group()
        self._process.wait()
        self._process = None

    def _end_group(self) -> None:
        """End the remaining processes of the child's group."""
        assert self._process is not None
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)


class Supervisor:
    """Child processes in order of dependency."""

    def __init__(self, plans: Sequence[ChildPlan]) -> None:
        self.children = [Child(plan) for plan in plans]

    def run(self, stopped: threading.Event, *, announce: Callable[[], bool] = lambda: True) -> None:
        """Run all children until `stopped`, and call `announce` until it returns True; stop them in reverse order."""
        announced = False
        try:
            for child in self.children:
                child.start()
                while not stopped.is_set() and not child.plan.ready():
                    child.ensure_running()
                    stopped.wait(0.02)
            while not stopped.wait(0.1):
                for child in self.children:
                    child.ensure_running()
                announced = announced or announce()
        finally:
            for child in reversed(self.children):
                child.stop()


def die_with_parent() -> None:
    """Ask the kernel to send SIGTERM when the parent ends for any reason; call it in the child."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
