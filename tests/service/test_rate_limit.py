"""Limits that replicas share."""

import asyncio
from pathlib import Path

from service.http.caller import Caller
from service.http.rate_limit import RateLimiter
from tests.servers import valkey

CALLER = Caller(owner="ann", key_id="k1", limits={"creates_per_min": 4})


def allowed(*limiters: RateLimiter, requests: int) -> list[bool]:
    async def ask() -> list[bool]:
        standings = [await limiters[n % len(limiters)].count(CALLER, "creates_per_min") for n in range(requests)]
        return [standing is not None and standing.allowed for standing in standings]

    return asyncio.run(ask())


def test_replicas_share_one_limit(tmp_path: Path) -> None:
    server, url = valkey(tmp_path)
    server.start()
    try:
        replicas = [RateLimiter(url) for _ in range(2)]
        assert allowed(*replicas, requests=6) == [True] * 4 + [False] * 2
    finally:
        server.stop()
    # Redis is away: each replica counts by itself, and nobody is refused for that
    assert allowed(replicas[0], requests=5) == [True] * 4 + [False]
