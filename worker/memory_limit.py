"""Bound the memory of the process that runs jobs, so that a job that needs too much fails and its worker survives."""

import os
import resource
from pathlib import Path

from jobs.settings import Settings

CGROUP_LIMITS = ("memory.max", "memory/memory.limit_in_bytes")  # cgroup version 2, version 1


def limit_memory(settings: Settings) -> int:
    """Limit this process's writable memory [bytes], and that of each program that it starts.

    An allocation beyond the limit raises MemoryError, which ends the job with `out-of-memory`.
    """
    share = 0.8  # the rest is for Celery's own process, the heartbeat and files in /tmp
    allowed = settings.job_memory_bytes or int(share * available_bytes())
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    allowed = allowed if hard == resource.RLIM_INFINITY else min(allowed, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (allowed, hard))
    return allowed


def available_bytes(cgroup: Path = Path("/sys/fs/cgroup")) -> int:
    """Return the memory of the machine, or of the container if that is less [bytes]."""
    available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for name in CGROUP_LIMITS:
        path = cgroup / name
        if path.is_file() and (text := path.read_text().strip()).isdecimal():
            available = min(available, int(text))
    return available


def is_allocation_failure(error: BaseException) -> bool:
    """Return whether an allocation failed; PyTorch raises RuntimeError for it."""
    return isinstance(error, MemoryError) or "can't allocate memory" in str(error) or "out of memory" in str(error)
