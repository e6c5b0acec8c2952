"""Rate limits per key, shared by all replicas of the API."""

import logging
import time
from dataclasses import dataclass

from limits import RateLimitItemPerSecond
from limits.errors import StorageError
from limits.storage import MemoryStorage, storage_from_string
from limits.strategies import FixedWindowRateLimiter
from starlette.concurrency import run_in_threadpool

from jobs.records import Limit
from service.http.caller import Caller

logger = logging.getLogger(__name__)


WRONG_KEYS_PER_MIN = 30
"""Limit per address: a misconfigured client sends few wrong keys, an attacker who guesses sends many."""


@dataclass(frozen=True, kw_only=True)
class Allowance:
    """Requests that remain in the current window. IETF draft ratelimit-headers."""

    name: str
    quota: int
    window_s: int
    left: int
    reset_s: int
    allowed: bool

    @property
    def headers(self) -> dict[str, str]:
        """Return RateLimit-Policy and RateLimit, and Retry-After if the limit is exceeded."""
        fields = {
            "RateLimit-Policy": f'"{self.name}";q={self.quota};w={self.window_s}',
            "RateLimit": f'"{self.name}";r={self.left};t={self.reset_s}',
        }
        return fields if self.allowed else fields | {"Retry-After": str(self.reset_s)}


def limit_of(method: str, path: str) -> Limit:
    """Return the limit that a request counts towards."""
    if path.startswith("/v1/interact"):
        return "interact_per_s"
    if method in {"GET", "HEAD", "OPTIONS"}:
        return "reads_per_min"
    # each photo of an asset is an upload, so creating an upload counts like one of its pieces
    chunk = method == "PATCH" or (method, path) == ("POST", "/v1/uploads")
    return "chunks_per_min" if chunk else "creates_per_min"


REDIS_TIMEOUT_S = 1.0
REDIS_PAUSE_S = 5.0
"""Pause after a failure of Redis before it is tried again [s]."""


class RateLimiter:
    """Fixed windows per key and policy, shared by replicas through Redis; counted in this process if Redis fails."""

    def __init__(self, redis_url: str) -> None:
        url = redis_url.replace("unix://", "redis+unix://", 1)
        timeouts = {"socket_timeout": REDIS_TIMEOUT_S, "socket_connect_timeout": REDIS_TIMEOUT_S}
        self._shared = FixedWindowRateLimiter(storage_from_string(url, wrap_exceptions=True, **timeouts))
        self._local = FixedWindowRateLimiter(MemoryStorage())
        self._away_until = 0.0

    async def count(self, caller: Caller, limit: Limit) -> Allowance | None:
        """Count one request; return None if the caller has no limit."""
        quota, (name, _, unit) = caller.limits.get(limit), limit.partition("_per_")
        return None if quota is None else await self._count(caller.key_id, name, quota, 1 if unit == "s" else 60)

    async def count_wrong_key(self, address: str) -> Allowance:
        """Count one request with a wrong key."""
        return await self._count(address, "wrong-keys", WRONG_KEYS_PER_MIN, 60)

    async def _count(self, who: str, name: str, quota: int, window_s: int) -> Allowance:
        if time.monotonic() >= self._away_until:
            try:
                return await run_in_threadpool(_count_request, self._shared, who, name, quota, window_s)
            except StorageError as error:
                logger.warning("redis is away; requests are counted in this process: %s", error)
                self._away_until = time.monotonic() + REDIS_PAUSE_S
        return _count_request(self._local, who, name, quota, window_s)


def _count_request(limiter: FixedWindowRateLimiter, who: str, name: str, quota: int, window_s: int) -> Allowance:
    window = RateLimitItemPerSecond(quota, window_s)
    allowed = limiter.hit(window, who, name)
    stats = limiter.get_window_stats(window, who, name)
    reset_s = max(1, round(stats.reset_time - time.time()))
    return Allowance(name=name, quota=quota, window_s=window_s, left=stats.remaining, reset_s=reset_s, allowed=allowed)
