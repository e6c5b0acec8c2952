"""What the routes share: settings, store, bytes, spectra in memory. Made once, by `create_app`."""

import asyncio
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar

from fastapi import Depends
from starlette.requests import HTTPConnection

from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.artifacts import ArtifactStore, open_artifacts
from jobs.outbound import Outbound
from jobs.settings import Settings
from jobs.store import Store
from jobs.upload_parts import PartStore, open_parts
from service.http.caller import ANYONE, CALLER, Caller
from service.job_durations import History
from service.job_notifier import Watching
from service.lru_cache import Recent
from service.uploads.upload_writer import Receivers

if TYPE_CHECKING:
    from redis import Redis

    from service.tree_cache import ReadyTree
    from service.uploads.ingest import Ingest

REDIS_TIMEOUT_S = 2.0


T = TypeVar("T")
_MAKING = threading.RLock()


class _Shared(Generic[T]):
    """A property that is made at its first use, once for a context and every view of it."""

    def __init__(self, make: Callable[[Any], T]) -> None:
        self.make = make
        self.__doc__ = make.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, seen: "Context", owner: type) -> T:
        whole = seen.whole or seen
        with _MAKING:
            if self.name not in whole.__dict__:
                whole.__dict__[self.name] = self.make(whole)
        made: T = whole.__dict__[self.name]
        seen.__dict__[self.name] = made
        return made


@dataclass(frozen=True)
class Context:
    """One process's settings and connections, opened at their first use; or what one caller may see of them."""

    settings: Settings
    caller: Caller = ANYONE
    whole: "Context | None" = None

    def seen_by(self, caller: Caller) -> "Context":
        """The context as a caller may see it: what others own is not there."""
        return self if caller.owner is None else replace(self, caller=caller, whole=self)

    def for_owner(self, owner: str) -> "Context":
        """The context as one owner may see it, whoever asks; the empty owner has what was made without a key."""
        return self.seen_by(Caller(owner=owner))

    @cached_property
    def store(self) -> Store:
        """The job store."""
        if self.whole is not None:
            assert self.caller.owner is not None
            return self.whole.store.for_owner(self.caller.owner)
        return Store.open(self.settings.resolved_database_url)

    @_Shared
    def parts(self) -> PartStore:
        """Uploads that are not whole yet."""
        return open_parts(self.settings.resolved_artifacts_url, credentials=self.settings.s3_credentials)

    @_Shared
    def receivers(self) -> Receivers:
        """Requests that write uploads."""
        return Receivers()

    @_Shared
    def ingest(self) -> "Ingest":
        """What makes assets without being waited for."""
        from service.uploads.ingest import Ingest

        return Ingest(self)

    @_Shared
    def history(self) -> History:
        """What things took here."""
        return History(self.store)

    @_Shared
    def watching(self) -> Watching:
        """Who waits for a job."""
        return Watching(self.store)

    @_Shared
    def outbound(self) -> Outbound:
        """The way to addresses that clients name."""
        return Outbound(private_hosts=self.settings.outbound_hosts)

    @_Shared
    def artifacts(self) -> ArtifactStore:
        """The bytes."""
        return open_artifacts(self.settings.resolved_artifacts_url, credentials=self.settings.s3_credentials)

    @_Shared
    def spectra(self) -> Recent[SparseVoxelSpectrum]:
        """Spectra that were used last, by the hash of their file."""
        return Recent(self.settings.spectrum_cache_bytes, lambda kept: kept.num_bytes)

    @_Shared
    def trees(self) -> "Recent[ReadyTree]":
        """Trees that were pushed last, by their owner and the id of their spectrum."""
        return Recent(self.settings.spectrum_cache_bytes, lambda kept: kept.num_bytes)

    @_Shared
    def parsing(self) -> asyncio.Semaphore:
        """How many uploads may be read at once."""
        return asyncio.Semaphore(self.settings.max_parsers)

    @_Shared
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


async def context_of(connection: HTTPConnection) -> Context:
    """The context of the application, as the caller may see it. Async: a plain function would cost a thread."""
    context: Context = connection.app.state.context
    caller: Caller = connection.scope.get(CALLER, ANYONE)
    return context.seen_by(caller)


Ctx = Annotated[Context, Depends(context_of)]
