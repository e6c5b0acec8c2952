"""Room for the state folder: that of its disk, or of a volume that is allowed less than its disk has."""

import os
import shutil
from contextlib import suppress
from pathlib import Path
from threading import Lock

from cachetools import TTLCache, cached

from jobs.settings import Settings


def free_bytes(settings: Settings) -> int:
    """What may still be written below `state_dir` [bytes]."""
    settings.scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    free = shutil.disk_usage(settings.scratch_dir).free
    if settings.state_size_bytes is None:
        return free
    return max(min(free, settings.state_size_bytes - used_bytes(settings.state_dir.resolve())), 0)


@cached(TTLCache(maxsize=4, ttl=1.0), lock=Lock())
def used_bytes(folder: Path) -> int:
    """What the files of a folder take; one with two names counts once [bytes]."""
    sizes: dict[int, int] = {}
    for parent, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                stat = os.lstat(os.path.join(parent, name))
                sizes[stat.st_ino] = 512 * stat.st_blocks
    return sum(sizes.values())
