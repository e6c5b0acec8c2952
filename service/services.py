"""Services that the process opens at start-up, and their restriction to one caller."""

import asyncio
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Annotated

import sqlalchemy as sa
from fastapi import Depends
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.clients.outbound import Outbound
from jobs.settings import Settings
from jobs.storage.artifacts import ArtifactStore, open_artifacts
from jobs.storage.upload_parts import PartStore, open_parts
from jobs.store import Store
from service.http.caller import ANYONE, CALLER, Caller
from service.http.slots import FairSlots, OpenStreams
from service.interact.lru_cache import LruCache
from service.interact.ready_tree import ReadyTree
from service.job_durations import JobDurations

logger = logging.getLogger(__name__)

POLL_S = 0.2
LARGE_ANSWERS = 3
"""Number of large responses, up to 128 MiB each, that are computed or sent at the same time."""


@dataclass
class JobNotifier:
    """Waiting requests by job; one task polls the store while there are any."""

    store: Store
    _waiting: dict[str, dict[asyncio.Future[None], int]] = field(default_factory=dict)
    _looking: asyncio.Task[None] | None = None

    async def changed(self, job_id: str, version: int, timeout_s: float) -> bool:
        """Wait until a job has another version or is gone; return False if the time runs out first."""
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(job_id, {})[waiter] = version
        if self._looking is None or self._looking.done():
            self._looking = asyncio.create_task(self._look())
        try:
            async with asyncio.timeout(timeout_s):
                await waiter
        except TimeoutError:
            return False
        finally:
            waiters = self._waiting.get(job_id, {})
            waiters.pop(waiter, None)
            if not waiters:
                self._waiting.pop(job_id, None)
        return True

    async def _look(self) -> None:
        while self._waiting:
            try:
                versions = await run_in_threadpool(self.store.job_versions, list(self._waiting))
            except sa.exc.SQLAlchemyError as error:
                logger.warning("changes cannot be looked for: %s", error)
            else:
                for job_id, waiters in self._waiting.items():
                    for waiter, version in waiters.items():
                        if versions.get(job_id) != version and not waiter.done():
                            waiter.set_result(None)
            await asyncio.sleep(POLL_S)


@dataclass(frozen=True, kw_only=True)
class Services:
    """Connections, caches and limits of one API process. Opened in the application's lifespan."""

    settings: Settings
    store: Store
    artifacts: ArtifactStore
    upload_parts: PartStore
    outbound: Outbound
    job_durations: JobDurations
    job_notifier: JobNotifier
    spectra: LruCache[SparseVoxelSpectrum]  # keys: hashes of spectrum files
    trees: LruCache[ReadyTree]  # keys: owner and spectrum id
    parsers: FairSlots
    streams: OpenStreams
    large_answers: FairSlots
    ingest_wakeup: asyncio.Event

    def owned_by(self, caller: Caller) -> "Owned":
        """Restrict the services to a caller: the store returns only rows of the caller's owner."""
        store = self.store if caller.owner is None else self.store.for_owner(caller.owner)
        return Owned(services=self, caller=caller, store=store)


@dataclass(frozen=True, kw_only=True)
class Owned:
    """Services restricted to one caller. Routes receive this, never `Services`."""

    services: Services
    caller: Caller
    store: Store


@contextmanager
def open_services(settings: Settings) -> Iterator[Services]:
    """Open every connection; close them at the end."""
    artifacts_url, credentials = settings.resolved_artifacts_url, settings.s3_credentials
    store = Store.open(settings.resolved_database_url)
    settings.scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        yield Services(
            settings=settings,
            store=store,
            artifacts=open_artifacts(artifacts_url, credentials=credentials),
            upload_parts=open_parts(artifacts_url, credentials=credentials),
            outbound=Outbound(private_hosts=settings.outbound_hosts),
            job_durations=JobDurations(store),
            job_notifier=JobNotifier(store),
            spectra=LruCache(settings.spectrum_cache_bytes, lambda spectrum: spectrum.num_bytes),
            trees=LruCache(settings.spectrum_cache_bytes, lambda tree: tree.num_bytes),
            parsers=FairSlots(settings.max_parsers, per_owner=settings.share_of(settings.max_parsers)),
            streams=OpenStreams(settings.max_streams),
            large_answers=FairSlots(LARGE_ANSWERS, per_owner=1 if settings.keys == "required" else LARGE_ANSWERS),
            ingest_wakeup=asyncio.Event(),
        )
    finally:
        store.close()


async def owned_by_caller(connection: HTTPConnection) -> Owned:
    """Restrict the services to a route's caller. Async, because FastAPI runs a plain function in a thread."""
    services: Services = connection.app.state.services
    caller: Caller = connection.scope.get(CALLER, ANYONE)
    return services.owned_by(caller)


OwnedDep = Annotated[Owned, Depends(owned_by_caller)]
