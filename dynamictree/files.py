"""Files named by a path: opened with a clear error, and written atomically."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from dynamictree.errors import InputError

_PARTIAL = ".partial-"
"""Prefix of temporary folders; the id of their process follows."""


@contextmanager
def open_input(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading, with an error message that explains what is wrong with the path.

    Raises:
        InputError: it cannot be read.
    """
    try:
        stream = path.open("rb")
    except IsADirectoryError:
        raise InputError(f"{path} is a folder; name a file in it") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    with stream:
        yield stream


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder, and move its files to `folder` at the end; after an error, move none.

    Raises:
        InputError: nothing can be written there, or there is no room.
    """
    is_new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _delete_abandoned(folder)
        written = Path(tempfile.mkdtemp(prefix=f"{_PARTIAL}{os.getpid()}-", dir=folder))
    except OSError as error:
        raise InputError(f"nothing can be written to {folder}: {error.strerror}; choose another folder") from None
    try:
        yield written
        for path in sorted(written.iterdir()):
            path.replace(folder / path.name)
    except BaseException as error:
        shutil.rmtree(written)
        if is_new:
            folder.rmdir()
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise InputError(f"there is no room in {folder}: {error.strerror}; free some, or choose another") from None
        raise
    written.rmdir()


def _delete_abandoned(folder: Path) -> None:
    """Delete the temporary folders of processes that were killed."""
    for path in folder.glob(f"{_PARTIAL}*-*"):
        pid = path.name.removeprefix(_PARTIAL).partition("-")[0]
        if pid.isdecimal() and os.name == "posix" and not _is_alive(int(pid)):
            shutil.rmtree(path, ignore_errors=True)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)  # signal 0 only tests whether the process exists
    except ProcessLookupError:
        return False
    except OSError:
        return True  # the process of another user
    return True


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Yield a stream whose content replaces `path` once it is complete; a crash or full disk leaves the old file."""
    partial = path.with_name(f"{path.name}.part")
    try:
        with partial.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
