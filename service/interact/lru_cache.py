"""Cache of the most recently used values, bounded in bytes."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class LruCache(Generic[T]):
    """Thread-safe cache of at most `max_bytes` in total; the newest value stays whatever its size."""

    def __init__(self, max_bytes: int, num_bytes: Callable[[T], int]) -> None:
        self.max_bytes = max_bytes
        self._num_bytes = num_bytes
        self._entries: OrderedDict[str, T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: str) -> T | None:
        """Return the cached value, or None."""
        with self._lock:
            if key in self._entries:
                self._entries.move_to_end(key)
            value = self._entries.get(key)
        self.trim()
        return value

    def put(self, key: str, thing: T) -> None:
        """Store a value and evict the least recently used ones."""
        with self._lock:
            self._entries[key] = thing
        self.trim()

    def trim(self) -> None:
        """Evict the least recently used values. Call it after a value has grown: sizes are measured again."""
        with self._lock:
            while len(self._entries) > 1 and sum(map(self._num_bytes, self._entries.values())) > self.max_bytes:
                self._entries.popitem(last=False)

    def __len__(self) -> int:
        return len(self._entries)
