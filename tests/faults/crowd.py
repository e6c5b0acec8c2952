"""Two thousand who poll at once, and some who are very slow: `python -m tests.faults.crowd`.

Every poller keeps its connection and asks for a job every few seconds; slow ones send a head byte by byte, a body that
stands still, or read nothing of a large answer. What is measured is how the pollers fare, and what the API weighs.
"""

import argparse
import asyncio
import shutil
import sys
import time
from collections import Counter
from contextlib import suppress

import numpy as np
import psutil

from tests import servers
from tests.faults.drill import parse, tell

HEAD = "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n"
SLOW_BODY = (
    "POST /v1/assets HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=x\r\n"
    "Content-Length: 1000000\r\n\r\n--x\r\n"
)


async def poller(port: int, path: str, until: float, every_s: float, waits: list[float], seen: Counter[str]) -> None:
    """One client on one connection."""
    await asyncio.sleep(every_s * np.random.default_rng().random())
    reader = writer = None
    while time.monotonic() < until:
        began = time.monotonic()
        try:
            if writer is None:
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(HEAD.format(path=path).encode())
            assert reader is not None
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 60)
            length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length"))
            await reader.readexactly(int(length.split(b":")[1]))
            waits.append(time.monotonic() - began)
            seen[head.split(b" ", 2)[1].decode()] += 1
        except (OSError, TimeoutError, asyncio.IncompleteReadError) as error:
            seen[type(error).__name__] += 1
            writer = None
        await asyncio.sleep(max(every_s - (time.monotonic() - began), 0))
    if writer is not None:
        writer.close()


async def slow_head(port: int, until: float, seen: Counter[str]) -> None:
    """A head that never ends."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: ")
    with suppress(OSError):
        while time.monotonic() < until and not reader.at_eof():
            writer.write(b"a")
            await asyncio.sleep(1)
    seen["slow heads ended by the server" if reader.at_eof() else "slow heads left open"] += 1
    writer.close()


async def slow_body(port: int, until: float, seen: Counter[str]) -> None:
    """A body that stands still."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(SLOW_BODY.encode())
    try:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n"), max(until - time.monotonic(), 0.1))
        seen[f"slow bodies answered {head.split(b' ', 2)[1].decode()}"] += 1
    except (TimeoutError, asyncio.IncompleteReadError):
        seen["slow bodies left waiting"] += 1
    writer.close()


async def crowd(port: int, *, pollers: int, slow: int, seconds: float, every_s: float) -> dict[str, object]:
    until = time.monotonic() + seconds
    waits: list[float] = []
    seen: Counter[str] = Counter()
    path = "/v1/jobs/01AAAAAAAAAAAAAAAAAAAAAAAA"  # 404 costs what 200 costs: a look into the store
    tasks = [poller(port, path, until, every_s, waits, seen) for _ in range(pollers)]
    tasks += [slow_head(port, until, seen) for _ in range(slow)] + [slow_body(port, until, seen) for _ in range(slow)]
    await asyncio.gather(*tasks)
    p50, p99 = (1000 * float(np.percentile(waits, share)) for share in (50, 99))
    return {
        "answers": dict(seen),
        "p50_ms": round(p50, 1),
        "p99_ms": round(p99, 1),
        "per_s": round(len(waits) / seconds),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pollers", type=int, default=2000)
    parser.add_argument("--slow", type=int, default=100, help="slow clients of each kind")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--every", type=float, default=10, help="seconds between two polls of one client")
    given, folder = parse(parser, prefix="crowd-")
    settings = {"DYNAMICTREE_STATE_DIR": str(folder / "state"), "DYNAMICTREE_UPLOAD_IDLE_S": "10"}
    front, url = servers.api(folder, settings)
    front.start()
    assert front.process is not None
    process = psutil.Process(front.process.pid)
    time.sleep(5)
    before = process.memory_full_info().uss / 2**20
    port, numbers = int(url.rsplit(":", 1)[1]), {"pollers": given.pollers, "slow": given.slow, "seconds": given.seconds}
    seen = asyncio.run(crowd(port, **numbers, every_s=given.every))
    after = process.memory_full_info().uss / 2**20
    tell(numbers | {"slow": 2 * given.slow} | seen | {"api_mib": [round(before, 1), round(after, 1)]})
    front.stop()
    if given.keep is None:
        shutil.rmtree(folder)
    answers = seen["answers"]
    assert isinstance(answers, dict)
    if set(answers) - {"404", "slow heads ended by the server", "slow bodies answered 408"}:
        sys.exit(f"not every poll was answered, or a slow client was left: {answers}")


if __name__ == "__main__":
    main()
