"""Reserve file that is deleted when the disk is full, so that the database can write and retention can free space."""

import logging
import os
import shutil
from pathlib import Path

logger = logging.getLogger(__name__)

RESERVE_BYTES = 64 * 1024**2
"""Enough for SQLite's log and Redis's file through many turns of retention."""


class DiskReserve:
    """Room for the housekeeper on the disk of the state folder."""

    def __init__(self, folder: Path, reserve_bytes: int = RESERVE_BYTES) -> None:
        self.path = folder / "disk-reserve"
        self.reserve_bytes = reserve_bytes

    def balance(self) -> None:
        """Delete the reserve if the disk is full; create it again once four times its size is free."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(self.path.parent).free
        there = self.path.exists()
        if there and free < self.reserve_bytes // 4:
            self.path.unlink()
            logger.error("the disk is full; %s bytes of reserve were given up for retention", self.reserve_bytes)
        elif not there and free > 4 * self.reserve_bytes:
            beside = self.path.with_suffix(".part")
            with beside.open("wb") as stream:
                os.posix_fallocate(stream.fileno(), 0, self.reserve_bytes)
            beside.rename(self.path)
