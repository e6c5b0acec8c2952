"""What a figure was measured on, and the median of several runs."""

import os
import platform
import statistics
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from time import perf_counter


def device() -> str:
    """Processor and cores."""
    names = [
        line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line
    ]
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores"


def versions(*names: str) -> dict[str, str]:
    """Python's and those of the packages that matter to a figure."""
    return {"python": platform.python_version()} | {name: version(name) for name in names}


def timed(action: Callable[[], object], *, runs: int = 5) -> dict[str, float]:
    """Median and slowest of several runs after one to warm up [s]."""
    action()
    seconds = []
    for _ in range(runs):
        began = perf_counter()
        action()
        seconds.append(perf_counter() - began)
    return {"median_s": statistics.median(seconds), "max_s": max(seconds)}
