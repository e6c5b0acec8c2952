"""Half-done reconstructions in scratch, which a retry, another job on the same photos or the next attempt resumes.

There is one folder per asset (the same files of one owner) and number of frames from a film. It stays when a job
fails, is canceled or is killed. It is deleted when the scene is learned, with its asset, or after a day.
"""

import fcntl
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from dynamictree.errors import InputError, ReconstructionError
from dynamictree.photo_requests import PHOTOS_OF_VIDEO, LearningParams
from jobs.records import JobRecord
from jobs.settings import Settings
from jobs.storage.stage_files import HALF_DONE

_CAMERAS = "views.json"  # written by `dynamictree.reconstruct` once cameras are found
_POLL_S = 0.5


def half_done_folder(settings: Settings, job: JobRecord) -> Path:
    """Return the folder for the work on a job's photos on this machine."""
    frames = LearningParams.part_of(job.params).video_frames or PHOTOS_OF_VIDEO
    return settings.scratch_dir / f"{HALF_DONE}{job.asset_id}-{frames}"


@contextmanager
def locked_folder(folder: Path, wait: Callable[[], None]) -> Iterator[None]:
    """Context manager to lock a folder.

    The folder is deleted at the end, unless an error occurs. After an error it stays, except if the photos caused the
    error before cameras were found. `wait` is called repeatedly while another job uses the folder; its exceptions pass
    through.
    """
    folder.mkdir(parents=True, exist_ok=True)
    while (lock := _acquire(folder)) is None:
        wait()
        time.sleep(_POLL_S)
    with lock:
        folder.mkdir(exist_ok=True)
        try:
            yield
        except (InputError, ReconstructionError):
            if not (folder / _CAMERAS).exists():
                _delete(folder)
            raise
        _delete(folder)


def discard(folder: Path) -> None:
    """Delete a folder, unless a job is using it."""
    lock = _acquire(folder)
    if lock is not None:
        with lock:
            _delete(folder)


def _delete(folder: Path) -> None:
    """Delete a locked folder, then the lock file; a waiting process creates a new one."""
    shutil.rmtree(folder, ignore_errors=True)
    _lock_of(folder).unlink(missing_ok=True)


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.lock")


def _acquire(folder: Path) -> IO[str] | None:
    """Acquire the folder's lock; return None while another process has it."""
    path = _lock_of(folder)
    lock = path.open("w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if path.exists() and os.path.samestat(path.stat(), os.fstat(lock.fileno())):  # it was not deleted meanwhile
            return lock
    except BlockingIOError:
        pass
    lock.close()
    return None
