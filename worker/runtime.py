"""Connections and settings of one worker process, opened after the pool has forked."""

import os
import socket
from dataclasses import dataclass
from functools import cache

from jobs.settings import Settings, read_settings
from jobs.storage.artifacts import ArtifactStore, open_artifacts
from jobs.store import Store
from worker.heartbeat import Heartbeat


@dataclass(frozen=True, kw_only=True)
class Runtime:
    """Connections and settings of one worker process."""

    settings: Settings
    store: Store
    artifacts: ArtifactStore
    owner: str
    heartbeat: Heartbeat


def open_runtime(settings: Settings) -> Runtime:
    """Open connections and register this worker. Call it after the fork: connections do not survive it."""
    owner = f"{socket.gethostname()}:{os.getpid()}"
    store = Store.open(settings.resolved_database_url)
    store.patience_s = settings.patience_s
    return Runtime(
        settings=settings,
        store=store,
        artifacts=open_artifacts(
            settings.resolved_artifacts_url, patience_s=settings.patience_s, credentials=settings.s3_credentials
        ),
        owner=owner,
        heartbeat=Heartbeat(settings, owner),
    )


def close_runtime(resources: Runtime) -> None:
    """Unregister this worker and close connections."""
    resources.heartbeat.leave()
    resources.store.close()


@cache
def runtime() -> Runtime:
    """Return this process's runtime, opened at the first call."""
    return open_runtime(read_settings())
