"""How often a key may ask. Counted in this process; each replica of the API counts by itself."""

import time
from dataclasses import dataclass

from jobs.keys import Limit
from service.http.caller import Caller

MAX_COUNTED = 10_000
"""Windows kept before those that are over are dropped."""


@dataclass(frozen=True, kw_only=True)
class Policy:
    """Requests a window, by the name that the RateLimit headers show."""

    name: str
    limit: Limit
    window_s: int


READS = Policy(name="reads", limit="reads_per_min", window_s=60)
CREATES = Policy(name="creates", limit="creates_per_min", window_s=60)
CHUNKS = Policy(name="chunks", limit="chunks_per_min", window_s=60)
INTERACT = Policy(name="interact", limit="interact_per_s", window_s=1)


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Where a key stands after a request. IETF draft ratelimit-headers."""

    policy: Policy
    quota: int
    left: int
    reset_s: int
    allowed: bool

    @property
    def headers(self) -> dict[str, str]:
        """RateLimit-Policy and RateLimit, and Retry-After where it is over."""
        name = f'"{self.policy.name}"'
        told = {
            "RateLimit-Policy": f"{name};q={self.quota};w={self.policy.window_s}",
            "RateLimit": f"{name};r={self.left};t={self.reset_s}",
        }
        return told if self.allowed else told | {"Retry-After": str(self.reset_s)}


def policy_of(method: str, path: str) -> Policy:
    """What a request counts as."""
    if path.startswith("/v1/interact"):
        return INTERACT
    if method in {"GET", "HEAD", "OPTIONS"}:
        return READS
    return CHUNKS if method == "PATCH" else CREATES


class Counter:
    """Fixed windows, one for each key and policy."""

    def __init__(self) -> None:
        self._windows: dict[tuple[str, str], tuple[float, int]] = {}

    def count(self, caller: Caller, policy: Policy, *, now: float | None = None) -> Standing | None:
        """Count one request; None where nothing is counted."""
        quota = caller.limits.get(policy.limit)
        if quota is None:
            return None
        now = time.monotonic() if now is None else now
        began, seen = self._windows.get((caller.key_id, policy.name), (now, 0))
        if now - began >= policy.window_s:
            began, seen = now, 0
        self._windows[caller.key_id, policy.name] = (began, seen + 1)
        if len(self._windows) > MAX_COUNTED:
            self._windows = {key: kept for key, kept in self._windows.items() if now - kept[0] < 60}
        reset_s = max(1, round(began + policy.window_s - now))
        return Standing(
            policy=policy, quota=quota, left=max(quota - seen - 1, 0), reset_s=reset_s, allowed=seen < quota
        )
