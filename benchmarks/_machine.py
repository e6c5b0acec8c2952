"""Description of the machine of a measurement, and timing functions."""

import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from dynamictree.parallel import in_bands

BRIEF = "DYNAMICTREE_BENCHMARK_BRIEF" in os.environ
"""Whether every benchmark runs in its shortest form, as in the tests, which run all of them."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Times of several runs [ms]. `cpu_ms` is the median CPU time over the cores, which other load does not affect."""

    median_ms: float
    p90_ms: float
    best_ms: float
    worst_ms: float
    cpu_ms: float

    def rounded(self) -> dict[str, float]:
        """Return the rounded times for printing."""
        return {name: round(value, 4) for name, value in asdict(self).items()}


def machine(*packages: str) -> dict[str, object]:
    """Return processor, cores, load, and the versions of relevant packages."""
    cpuinfo = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":", 1)[1].strip() for line in cpuinfo if "model name" in line]
    return {
        "device": f"{names[0] if names else platform.machine()}, {cores()} cores",
        "load": round(os.getloadavg()[0], 2),
        "versions": {"python": platform.python_version()} | {name: version(name) for name in packages},
    }


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def time_calls(call: Callable[[], object], *, runs: int = 60, warm_ups: int = 1) -> Timing:
    """Time several runs of a call."""
    for _ in range(warm_ups):
        call()
    wall, spent = [], []
    for _ in range(2 if BRIEF else runs):
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


def time_copy(num_bytes: int) -> Timing:
    """Time a copy on all cores that reads and writes this many bytes in total: the cost of memory alone."""
    source = np.ones(num_bytes // 8, np.float32)  # memory that was never written maps to one cached page of zeros
    target = np.empty_like(source)

    def copy(first: int, end: int) -> None:
        target[first:end] = source[first:end]

    return time_calls(lambda: in_bands(copy, len(source)), runs=30)


def ratio_to_copy(frame: Timing, floor: Timing) -> dict[str, float]:
    """Compare a frame with the copy of its bytes, in wall time and in CPU time, which does not depend on other load."""
    return {
        "floor_ms": round(floor.median_ms, 3),
        "over_floor": round(frame.median_ms / floor.median_ms, 2),
        "processor_over_floor": round(frame.cpu_ms / floor.cpu_ms, 2),
        "share_of_peak_bandwidth": round(floor.median_ms / frame.median_ms, 3),
    }
