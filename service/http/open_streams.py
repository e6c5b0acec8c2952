"""Bounds on streams that stay open: WebSockets and server-sent events."""

import asyncio
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import sqlalchemy as sa
from starlette.concurrency import run_in_threadpool

from jobs.clients.keys import is_valid
from jobs.store import Store
from service.http.caller import Caller
from service.http.problems import ProblemError

CHECK_S = 5.0
"""How often an open stream asks whether its key is still valid."""


class OpenStreams:
    """Streams of this process, per owner. For one event loop."""

    def __init__(self, total: int) -> None:
        self.total = total
        self._open: Counter[str] = Counter()

    @property
    def num_open(self) -> int:
        """Streams that are open."""
        return self._open.total()

    @contextmanager
    def opened(self, caller: Caller) -> Iterator[None]:
        """Context manager that counts one stream while it is open.

        Raises:
            ProblemError: the owner, or the process, has too many.
        """
        owner = caller.owner or ""
        allowed = min(caller.limits.get("streams", self.total), self.total)
        if self._open[owner] >= allowed or self._open.total() >= self.total:
            detail = f"{self._open[owner]} of your streams are open; {allowed} are allowed: close one"
            raise ProblemError("rate-limited", detail, headers={"Retry-After": "5"})
        self._open[owner] += 1
        try:
            yield
        finally:
            self._open[owner] -= 1


async def until_revoked(store: Store, caller: Caller) -> None:
    """Return once the caller's key is revoked or has expired; never where no key is required."""
    while True:
        await asyncio.sleep(CHECK_S)
        if not caller.key_id:
            continue
        try:
            if not await run_in_threadpool(is_valid, store, caller.key_id):
                return
        except sa.exc.SQLAlchemyError:
            continue  # the database is away; it will tell later
