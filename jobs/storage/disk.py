"""Free space for the state folder: that of its disk, or of a volume with a smaller limit."""

import os
import shutil
from contextlib import suppress
from pathlib import Path
from threading import Lock
from time import monotonic

from cachetools import TLRUCache, cached

from jobs.settings import Settings


def free_bytes(settings: Settings) -> int:
    """Return the free space for `state_dir` [bytes]."""
    settings.scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    free = shutil.disk_usage(settings.scratch_dir).free
    if settings.state_size_bytes is not None:
        free = min(free, settings.state_size_bytes - used(settings.state_dir.resolve())[0])
    return max(free, 0)


@cached(TLRUCache(maxsize=4, ttu=lambda _, walk, now: now + max(1.0, 100 * walk[1])), lock=Lock())
def used(folder: Path) -> tuple[int, float]:
    """Return a folder's disk usage [bytes], hard links counted once, and the time of the measurement [s]."""
    began, sizes = monotonic(), dict[int, int]()
    for parent, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                stat = os.lstat(os.path.join(parent, name))
                sizes[stat.st_ino] = 512 * stat.st_blocks
    return sum(sizes.values()), monotonic() - began
