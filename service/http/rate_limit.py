"""Requests per key and time, shared by all replicas of the API."""

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


@dataclass(frozen=True, kw_only=True)
class Policy:
    """Requests a window, by the name that the RateLimit headers show."""

    name: str
    limit: Limit
    window_s: int


READS = Policy(name="reads", limit="reads_per_min", window_s=60)
CREATES = Policy(name="creates", limit="creates_per_min", window_s=60)
CHUNKS = Policy(name="chunks", limit="chunks_per_min", window_s=60)
WRONG_KEYS = Policy(name="wrong-keys", limit="creates_per_min", window_s=60)
WRONG_KEYS_PER_MIN = 30
"""From one address: a client with a wrong key tries now and then, who guesses tries without end."""

INTERACT = Policy(name="interact", limit="interact_per_s", window_s=1)


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Remaining requests of a key after a request. IETF draft ratelimit-headers."""

    policy: Policy
    quota: int
    left: int
    reset_s: int
    allowed: bool

    @property
    def headers(self) -> dict[str, str]:
        """RateLimit-Policy and RateLimit, and Retry-After where it is over."""
        name = f'"{self.policy.name}"'
        fields = {
            "RateLimit-Policy": f"{name};q={self.quota};w={self.policy.window_s}",
            "RateLimit": f"{name};r={self.left};t={self.reset_s}",
        }
        return fields if self.allowed else fields | {"Retry-After": str(self.reset_s)}


def policy_of(method: str, path: str) -> Policy:
    """Rate-limit policy of a request."""
    if path.startswith("/v1/interact"):
        return INTERACT
    if method in {"GET", "HEAD", "OPTIONS"}:
        return READS
    # photos are uploads of one asset each: to announce one counts like a piece of one
    return CHUNKS if method == "PATCH" or (method, path) == ("POST", "/v1/uploads") else CREATES


REDIS_TIMEOUT_S = 1.0
AWAY_S = 5.0
"""How long Redis is not asked after it did not answer."""


class RateLimiter:
    """Fixed windows, one per key and policy, in Redis: replicas share them. In this process while Redis is away."""

    def __init__(self, redis_url: str) -> None:
        url = redis_url.replace("unix://", "redis+unix://", 1)
        timeouts = {"socket_timeout": REDIS_TIMEOUT_S, "socket_connect_timeout": REDIS_TIMEOUT_S}
        self._shared = FixedWindowRateLimiter(storage_from_string(url, wrap_exceptions=True, **timeouts))
        self._local = FixedWindowRateLimiter(MemoryStorage())
        self._away_until = 0.0

    async def count(self, caller: Caller, policy: Policy) -> Standing | None:
        """Count one request; None where the caller has no limit."""
        quota = caller.limits.get(policy.limit)
        return None if quota is None else await self._count(caller.key_id, policy, quota)

    async def count_wrong_key(self, address: str) -> Standing:
        """Count one request with a wrong key."""
        return await self._count(address, WRONG_KEYS, WRONG_KEYS_PER_MIN)

    async def _count(self, who: str, policy: Policy, quota: int) -> Standing:
        if time.monotonic() >= self._away_until:
            try:
                return await run_in_threadpool(_hit, self._shared, who, policy, quota)
            except StorageError as error:
                logger.warning("redis is away; requests are counted in this process: %s", error)
                self._away_until = time.monotonic() + AWAY_S
        return _hit(self._local, who, policy, quota)


def _hit(limiter: FixedWindowRateLimiter, key_id: str, policy: Policy, quota: int) -> Standing:
    window = RateLimitItemPerSecond(quota, policy.window_s)
    allowed = limiter.hit(window, key_id, policy.name)
    stats = limiter.get_window_stats(window, key_id, policy.name)
    reset_s = max(1, round(stats.reset_time - time.time()))
    return Standing(policy=policy, quota=quota, left=stats.remaining, reset_s=reset_s, allowed=allowed)
