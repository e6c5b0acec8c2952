"""What the routes share: settings, store, bytes, spectra in memory. Made once, by `create_app`."""

import asyncio
import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

from fastapi import Depends, Request

from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.artifacts import ArtifactStore, open_artifacts
from jobs.settings import Settings
from jobs.store import Store

if TYPE_CHECKING:
    from redis import Redis

    from service.trees import ReadyTrees

REDIS_TIMEOUT_S = 2.0


class SpectrumCache:
    """The spectra that were used last, up to a number of bytes. Keyed by the hash of their file."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self._spectra: OrderedDict[str, SparseVoxelSpectrum] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, digest: str) -> SparseVoxelSpectrum | None:
        """The spectrum, if it is kept."""
        with self._lock:
            if digest in self._spectra:
                self._spectra.move_to_end(digest)
            return self._spectra.get(digest)

    def put(self, digest: str, spectrum: SparseVoxelSpectrum) -> None:
        """Keep a spectrum; drop those that were not used for longest."""
        with self._lock:
            self._spectra[digest] = spectrum
            while self._spectra and self.num_bytes > self.max_bytes:
                self._spectra.popitem(last=False)

    @property
    def num_bytes(self) -> int:
        """What is kept [bytes]."""
        return sum(kept.coefficients.nbytes + kept.grid.coords.nbytes for kept in self._spectra.values())


@dataclass(frozen=True)
class Context:
    """One process's settings and connections, opened at their first use."""

    settings: Settings

    @cached_property
    def store(self) -> Store:
        """The job store."""
        return Store.open(self.settings.resolved_database_url)

    @cached_property
    def artifacts(self) -> ArtifactStore:
        """The bytes."""
        return open_artifacts(self.settings.resolved_artifacts_url)

    @cached_property
    def spectra(self) -> SpectrumCache:
        """Spectra in memory."""
        return SpectrumCache(self.settings.spectrum_cache_bytes)

    @cached_property
    def trees(self) -> "ReadyTrees":
        """Trees made ready to be pushed."""
        from service.trees import ReadyTrees

        return ReadyTrees(self.settings.spectrum_cache_bytes)

    @cached_property
    def parsing(self) -> asyncio.Semaphore:
        """How many uploads may be read at once."""
        return asyncio.Semaphore(self.settings.max_parsers)

    @cached_property
    def redis(self) -> "Redis":
        """The broker, only to ask whether it is there."""
        from redis import Redis

        url = self.settings.resolved_redis_url
        timeouts = {"socket_timeout": REDIS_TIMEOUT_S, "socket_connect_timeout": REDIS_TIMEOUT_S}
        return Redis.from_url(url, **timeouts)

    def close(self) -> None:
        """Drop every connection."""
        if "store" in self.__dict__:
            self.store.close()
        if "redis" in self.__dict__:
            self.redis.close()


async def context_of(request: Request) -> Context:
    """The context of the application that serves this request. Async: a plain function would cost a thread."""
    context: Context = request.app.state.context
    return context


Ctx = Annotated[Context, Depends(context_of)]
