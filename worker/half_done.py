"""Half-done reconstructions in scratch: a retry, another job on the same photos, or the next attempt goes on there.

A folder belongs to an asset, which is the same files of one owner, and to the number of frames taken of a film. It
stays when a job fails, is canceled or is killed, and goes when the scene is learned, with its asset, or after a day.
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

_CAMERAS = "views.json"  # what `dynamictree.reconstruct` writes once cameras are found
_LOOK_S = 0.5


def half_done_folder(settings: Settings, job: JobRecord) -> Path:
    """Where the work on a job's photos lies on this machine."""
    frames = LearningParams.part_of(job.params).video_frames or PHOTOS_OF_VIDEO
    return settings.scratch_dir / f"{HALF_DONE}{job.asset_id}-{frames}"


@contextmanager
def alone_in(folder: Path, wait: Callable[[], None]) -> Iterator[bool]:
    """Work in a folder alone; gives whether another job was there meanwhile, whose result may be stored now.

    Without an error the folder is deleted at the end. It stays on every error but one of the photos themselves, met
    before cameras were found.

    Args:
        folder: as `half_done_folder`; made if it does not exist.
        wait: called while another job is at work there; what it raises passes through.
    """
    folder.mkdir(parents=True, exist_ok=True)
    waited = False
    while (lock := _taken(folder)) is None:
        waited = True
        wait()
        time.sleep(_LOOK_S)
    with lock:
        folder.mkdir(exist_ok=True)
        try:
            yield waited
        except (InputError, ReconstructionError):
            if not (folder / _CAMERAS).exists():
                _delete(folder)
            raise
        _delete(folder)


def discard(folder: Path) -> None:
    """Delete a folder, unless a job is at work there."""
    lock = _taken(folder)
    if lock is not None:
        with lock:
            _delete(folder)


def _delete(folder: Path) -> None:
    """Delete a locked folder, then the lock: whoever waits for it takes a new one."""
    shutil.rmtree(folder, ignore_errors=True)
    _lock_of(folder).unlink(missing_ok=True)


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.lock")


def _taken(folder: Path) -> IO[str] | None:
    """The folder's lock, or None while another has it."""
    path = _lock_of(folder)
    lock = path.open("w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if path.exists() and os.path.samestat(path.stat(), os.fstat(lock.fileno())):  # not deleted meanwhile
            return lock
    except BlockingIOError:
        pass
    lock.close()
    return None
