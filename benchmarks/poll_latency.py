"""How long a poll takes at 300 requests a second beside a worker that is busy on one thread.

Half of the two cores is the worker's; API, housekeeper and the load generator share the rest.
"""

import os

from benchmarks._load import busy_service, load

TARGET_MS = 25.0
RATE = 300
CONNECTIONS = 30
SECONDS = int(os.environ.get("POLL_SECONDS") or 20)
HIGHER = (450, 600, 800, 1000)


def run() -> dict[str, object]:
    with busy_service() as (url, job, _):
        poll = f"{url}/v1/jobs/{job}"
        load(poll, rate=RATE, connections=CONNECTIONS, seconds=3)  # warms up
        measured = load(poll, rate=RATE, connections=CONNECTIONS, seconds=SECONDS)
        sustained = RATE if measured.p99_ms <= TARGET_MS and measured.requests_s > 0.97 * RATE else 0
        for rate in HIGHER if sustained else ():
            more = load(poll, rate=rate, connections=CONNECTIONS, seconds=8)
            if more.p99_ms > TARGET_MS or more.requests_s < 0.97 * rate:
                break
            sustained = rate
    return measured.figures(target_ms=TARGET_MS) | {
        "highest_rate_held_s": sustained,
        "connections": CONNECTIONS,
        "seconds": SECONDS,
        "worker_threads": 1,
    }
