"""Retry policy: which requests are sent again, and after how long."""

import random
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

import httpx

_NOT_DONE = (429, 503)  # refused before any effect, so any request may be repeated
_UNKNOWN = (408, 500, 502, 504)  # the request may have had an effect


@dataclass(frozen=True, kw_only=True)
class Retries:
    """At most `attempts` in total. Without a Retry-After the wait doubles from `first_wait_s`, with random jitter."""

    attempts: int = 5
    first_wait_s: float = 0.5
    longest_wait_s: float = 60.0  # a longer Retry-After is not waited for
    draw: Callable[[], float] = random.random

    def wait_s(self, attempt: int, outcome: httpx.Response | httpx.TransportError, *, repeatable: bool) -> float | None:
        """Return the time to wait after an attempt, counted from 1 [s]; None means no further attempt."""
        if attempt >= self.attempts:
            return None
        backoff: float = min(self.first_wait_s * 2 ** (attempt - 1), self.longest_wait_s) * (0.5 + 0.5 * self.draw())
        if not isinstance(outcome, httpx.Response):
            never_sent = isinstance(outcome, httpx.ConnectError | httpx.ConnectTimeout | httpx.PoolTimeout)
            return backoff if repeatable or never_sent else None
        again = outcome.status_code in _NOT_DONE or (repeatable and outcome.status_code in _UNKNOWN)
        if not again:
            return None
        pause_s = retry_after_s(outcome)
        if pause_s is None:
            return backoff
        return pause_s if pause_s <= self.longest_wait_s else None


def retry_after_s(response: httpx.Response) -> float | None:
    """Parse the Retry-After header in either form [s]; None if it is missing or invalid."""
    header: str = response.headers.get("retry-after", "").strip()
    if header.isdecimal():
        return float(header)
    try:
        moment = parsedate_to_datetime(header)
    except ValueError:
        return None
    return max((moment.replace(tzinfo=moment.tzinfo or UTC) - datetime.now(UTC)).total_seconds(), 0.0)
