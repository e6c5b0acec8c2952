"""What a worker's process has: settings, store, bytes, a name. Opened after the pool has forked, once a process."""

import logging
import os
import socket
import threading
from dataclasses import dataclass
from functools import cache

import sqlalchemy as sa

from jobs.artifacts import ArtifactStore, open_artifacts
from jobs.settings import Settings, read_settings
from jobs.store import Store
from jobs.upkeep import hold_lease, release_lease

logger = logging.getLogger(__name__)

PRESENCE_S = 5.0
"""How often a worker says that it is there; it is missed after three times as long."""


@dataclass(frozen=True, kw_only=True)
class Runtime:
    """One process of one worker."""

    settings: Settings
    store: Store
    artifacts: ArtifactStore
    owner: str


@cache
def runtime() -> Runtime:
    """Give the process's own. Call it only in the process that will use it: connections do not survive a fork."""
    settings = read_settings()
    return Runtime(
        settings=settings,
        store=Store.open(settings.resolved_database_url),
        artifacts=open_artifacts(settings.resolved_artifacts_url),
        owner=f"{socket.gethostname()}:{os.getpid()}",
    )


class Presence:
    """Says in the store that this worker is there, from a thread, until it is left."""

    def __init__(self, here: Runtime) -> None:
        self._here = here
        self._name = f"worker:{here.owner}"
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._run, name="presence", daemon=True)
        self._thread.start()

    def leave(self) -> None:
        """Say that it is gone."""
        self._left.set()
        self._thread.join()
        release_lease(self._here.store, self._name, owner=self._here.owner)

    def _run(self) -> None:
        self._say()
        _load_heavy_modules()
        while not self._left.wait(PRESENCE_S):
            self._say()

    def _say(self) -> None:
        try:
            hold_lease(self._here.store, self._name, owner=self._here.owner, lease_s=3 * PRESENCE_S)
        except sa.exc.SQLAlchemyError:
            logger.warning("the database is away; this worker cannot say that it is there", exc_info=True)


def _load_heavy_modules() -> None:
    """Bring in numba and torch, so that the first job need not wait. After the fork, where torch may be imported."""
    import worker.stages  # noqa: F401
