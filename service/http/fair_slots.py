"""A semaphore shared fairly: the owner with the fewest slots is next."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager


class FairSlots:
    """`total` slots, of which one owner holds at most `per_owner`. For one event loop."""

    def __init__(self, total: int, *, per_owner: int) -> None:
        self.total = total
        self.per_owner = per_owner
        self._active: Counter[str] = Counter()
        self._waiting: list[tuple[str, asyncio.Future[None]]] = []  # in order of arrival

    @asynccontextmanager
    async def slot(self, owner: str) -> AsyncIterator[None]:
        """Context manager that waits for a slot and occupies it."""
        entry = (owner, asyncio.get_running_loop().create_future())
        self._waiting.append(entry)
        self._grant()
        try:
            await entry[1]
        except asyncio.CancelledError:
            if entry in self._waiting:
                self._waiting.remove(entry)
            else:  # granted in the same moment
                self._release(owner)
            raise
        try:
            yield
        finally:
            self._release(owner)

    def _release(self, owner: str) -> None:
        self._active[owner] -= 1
        self._grant()

    def _grant(self) -> None:
        while self._active.total() < self.total:
            eligible = [entry for entry in self._waiting if self._active[entry[0]] < self.per_owner]
            if not eligible:
                return
            chosen = min(eligible, key=lambda entry: self._active[entry[0]])
            self._waiting.remove(chosen)
            self._active[chosen[0]] += 1
            chosen[1].set_result(None)
