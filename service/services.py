"""Services that the process opens at start-up, and their restriction to one caller."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends
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
from service.job_notifier import JobNotifier


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


LARGE_ANSWERS = 3
"""Number of large responses, up to 128 MiB each, that are computed or sent at the same time."""


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
