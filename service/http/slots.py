"""Limits that callers share fairly: slots for costly work, and open streams."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from weakref import WeakValueDictionary

import sqlalchemy as sa
from starlette.concurrency import run_in_threadpool

from jobs.clients.keys import find_key
from jobs.store import Store
from service.http.caller import Caller
from service.http.problems import ProblemError


class FairSlots:
    """`total` slots; one owner occupies or queues for at most `per_owner` of them at a time."""

    def __init__(self, total: int, *, per_owner: int) -> None:
        self.per_owner = per_owner
        self._all = asyncio.Semaphore(total)  # serves in order of arrival
        self._of_owner = WeakValueDictionary[str, asyncio.Semaphore]()

    @asynccontextmanager
    async def slot(self, owner: str) -> AsyncIterator[None]:
        """Context manager that waits for a slot and occupies it."""
        async with self._of_owner.setdefault(owner, asyncio.Semaphore(self.per_owner)), self._all:
            yield


CHECK_S = 5.0
"""Interval at which an open stream checks whether its key is still valid [s]."""


class OpenStreams:
    """Number of open streams of this process per owner. Use it from one event loop."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.open: Counter[str] = Counter()

    @contextmanager
    def opened(self, caller: Caller) -> Iterator[None]:
        """Context manager that counts one stream while it is open."""
        owner = caller.owner or ""
        allowed = min(caller.limits.get("streams", self.total), self.total)
        if self.open[owner] >= allowed or self.open.total() >= self.total:
            detail = f"{self.open[owner]} of your streams are open; {allowed} are allowed: close one"
            raise ProblemError("rate-limited", detail, headers={"Retry-After": "5"})
        self.open[owner] += 1
        try:
            yield
        finally:
            self.open[owner] -= 1


async def until_revoked(store: Store, caller: Caller) -> None:
    """Wait until the caller's key is revoked or expires; forever if no key is required."""
    while True:
        await asyncio.sleep(CHECK_S)
        if not caller.key_id:
            continue
        try:
            key = await run_in_threadpool(find_key, store, id=caller.key_id)
            if key is None or not key.valid(store.clock()):
                return
        except sa.exc.SQLAlchemyError:
            continue  # the database is unavailable: check again later
