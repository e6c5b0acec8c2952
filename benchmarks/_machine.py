"""What a figure was measured on, and how long something takes."""

import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Of several runs [ms]. `cpu_ms` is the median processor time over the cores: what others' work cannot hide."""

    median_ms: float
    p90_ms: float
    best_ms: float
    worst_ms: float
    cpu_ms: float

    def rounded(self) -> dict[str, float]:
        """As it is printed."""
        return {name: round(value, 4) for name, value in asdict(self).items()}


def machine(*packages: str) -> dict[str, object]:
    """Processor and cores, how busy they are, and the versions of what matters to a figure."""
    cpuinfo = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":", 1)[1].strip() for line in cpuinfo if "model name" in line]
    return {
        "device": f"{names[0] if names else platform.machine()}, {cores()} cores",
        "load": round(os.getloadavg()[0], 2),
        "versions": {"python": platform.python_version()} | {name: version(name) for name in packages},
    }


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0))


def timed(call: Callable[[], object], *, runs: int = 60, warm_ups: int = 1) -> Timing:
    """Time several runs of a call."""
    for _ in range(warm_ups):
        call()
    wall, spent = [], []
    for _ in range(runs):
        began, before = time.perf_counter(), time.process_time()
        call()
        wall.append((time.perf_counter() - began) * 1e3)
        spent.append((time.process_time() - before) * 1e3 / cores())
    return Timing(
        median_ms=statistics.median(wall),
        p90_ms=statistics.quantiles(wall, n=10, method="inclusive")[-1],
        best_ms=min(wall),
        worst_ms=max(wall),
        cpu_ms=statistics.median(spent),
    )
