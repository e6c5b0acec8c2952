"""Renew a lease from a separate process, because a numerical kernel may hold the GIL for a minute.

`python -m worker.heartbeat`, started by `Heartbeat`. The first line on stdin names the owner and the interval, each
further line the attempt to renew. It stops at the end of stdin: then the worker has ended, for any reason.
"""

import json
import logging
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from jobs.errors import FencedError
from jobs.lifecycle.attempts import renew
from jobs.lifecycle.maintenance import hold_lease, release_lease, worker_lease
from jobs.logging_setup import set_up_logging
from jobs.records import Claim
from jobs.settings import Settings, read_settings
from jobs.store import Store

logger = logging.getLogger(__name__)

READY = b"beats\n"
PRESENCE_S = 5.0
"""Interval at which a worker reports its presence [s]; it counts as gone after three intervals."""


class Heartbeat:
    """Heartbeat process, as controlled by the worker."""

    def __init__(self, settings: Settings, owner: str) -> None:
        self._first: dict[str, str | int | float] = {
            "database_url": settings.resolved_database_url,
            "owner": owner,
            "queue": settings.worker_queue,
            "lease_s": settings.lease_s,
            "heartbeat_s": settings.heartbeat_s,
        }
        self._process = self._start()
        self._beats = False
        self._waiting = threading.RLock()

    @property
    def pid(self) -> int:
        """Return the id of the heartbeat process."""
        return self._process.pid

    def wait(self) -> None:
        """Wait until the heartbeat process runs; restart it if it has died. Call it before taking a lease."""
        with self._waiting:  # READY comes once; if two threads read, one would wait forever
            while (died := self._process.poll() is not None) or not self._beats:
                if died:
                    self.leave()
                    self._process, self._beats = self._start(), False
                assert self._process.stdout is not None
                self._beats = self._process.stdout.readline() == READY

    def hold(self, claimed: Claim) -> None:
        """Start renewing this attempt's lease."""
        self._tell({"job_id": claimed.job.id, "attempt": claimed.attempt})

    def drop(self) -> None:
        """Stop renewing the lease."""
        self._tell({})

    def _start(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "worker.heartbeat"]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        _write(process, self._first)
        return process

    def leave(self) -> None:
        """End the process; it deletes this worker's lease."""
        with self._waiting, suppress(BrokenPipeError):  # a thread may still read the first beat
            self._process.communicate()
        self._process.wait()

    def _tell(self, message: dict[str, str | int | float]) -> None:
        try:
            _write(self._process, message)
        except BrokenPipeError:
            logger.error("the heartbeat's process has died; the lease runs out")


def _write(process: subprocess.Popen[bytes], message: dict[str, str | int | float]) -> None:
    assert process.stdin is not None
    process.stdin.write(json.dumps(message).encode() + b"\n")
    process.stdin.flush()


def is_process_stopped(pid: int) -> bool:
    """Return whether a process was stopped by a signal or a debugger; False if the system does not report it."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] in {"T", "t"}


def _write_to_store(say: Callable[[], object]) -> bool:
    """Write to the store, unless the worker is stopped; return whether the lease is still valid.

    If the database is unavailable, the lease continues for a while; then the reaper decides.
    """
    try:
        if not is_process_stopped(os.getppid()):
            say()
    except FencedError:
        return False
    except sa.exc.SQLAlchemyError:
        logger.warning("the database is away; the worker's leases could not be renewed", exc_info=True)
    return True


def main() -> None:
    """Renew leases until stdin ends."""
    set_up_logging(read_settings())
    first = json.loads(sys.stdin.buffer.readline())
    store, owner = Store.open(first["database_url"]), first["owner"]
    presence = worker_lease(first["queue"], owner)
    say_present = partial(hold_lease, store, presence, owner=owner, lease_s=3 * PRESENCE_S)
    claimed: dict[str, Any] = {}
    present_at = renewed_at = -1e9
    pending = b""
    while True:
        now = time.monotonic()
        if claimed and now - renewed_at >= first["heartbeat_s"]:
            ours = _write_to_store(partial(renew, store, **claimed, owner=owner, lease_s=first["lease_s"]))
            claimed = claimed if ours else {}
            renewed_at = now
        if now - present_at >= PRESENCE_S:
            _write_to_store(say_present)
            if present_at < 0:
                sys.stdout.buffer.write(READY)
                sys.stdout.buffer.flush()
            present_at = now
        if not select.select([0], [], [], min(first["heartbeat_s"], PRESENCE_S))[0]:
            continue
        pending += (received := os.read(0, 65536))
        if not received:
            break
        *lines, pending = pending.split(b"\n")
        if lines:
            claimed = json.loads(lines[-1])
    release_lease(store, presence, owner=owner)


if __name__ == "__main__":
    main()
