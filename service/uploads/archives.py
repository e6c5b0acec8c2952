"""Unpack uploaded zips: entries are checked before reading, bytes are counted while reading."""

import errno
import lzma
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path, PurePosixPath

from dynamictree.formats.companions import is_system_file
from service.http.multipart import MAX_FILES, ReceivedFile
from service.http.problems import ProblemError

MAX_RATIO = 100
MAX_UNPACKED_BYTES = 4 * 1024**3
CHUNK_BYTES = 1024 * 1024
UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
    *(RuntimeError, EOFError, ValueError, OverflowError),
)
"""Exceptions that zipfile raises for a corrupt or inconsistent file."""

_UTF8_NAME = 0x800  # PKWARE's APPNOTE 6.3, section 4.4.4, bit 11
ARCHIVE_SUFFIXES = frozenset({".zip", ".tar", ".gz", ".tgz", ".7z", ".rar", ".xz", ".bz2", ".zst"})


def is_zip(path: Path) -> bool:
    """Return whether a file begins with the signature of a zip."""
    with path.open("rb") as stream:
        return stream.read(4) in {b"PK\x03\x04", b"PK\x05\x06"}


def unpack(
    archive: ReceivedFile, folder: Path, *, require_room: Callable[[int], None] = lambda declared: None
) -> list[ReceivedFile]:
    """Unpack into `folder` as entry-0, entry-1 and so on; names in the zip are never used as paths.

    `require_room` is called with the unpacked size [bytes] before anything is written, and may refuse.

    Raises:
        ProblemError: the zip is broken, too large, or holds what an upload never needs.
    """
    try:
        with zipfile.ZipFile(archive.path) as opened:
            for entry in opened.infolist():
                entry.filename = _name(entry)
            entries = [
                entry
                for entry in opened.infolist()
                if not entry.filename.endswith("/") and not is_system_file(entry.filename)
            ]
            require_room(_check(entries, archive.bytes))
            left = MAX_UNPACKED_BYTES
            files = []
            for number, entry in enumerate(entries):
                files.append(_unpack_one(opened, entry, folder / f"entry-{number}", left))
                left -= files[-1].bytes
    except OSError as error:
        if error.errno != errno.EINVAL:  # EINVAL: an entry starts before the file, an error of the sender
            raise
        raise _unreadable(error) from error
    except UNREADABLE as error:
        raise _unreadable(error) from error
    return files


def _name(entry: zipfile.ZipInfo) -> str:
    """Return the entry's path with forward slashes; decode UTF-8 even without its flag, as Finder writes it."""
    name = entry.filename.replace("\\", "/")
    if entry.flag_bits & _UTF8_NAME:
        return name
    try:
        return name.encode("cp437").decode()
    except UnicodeError:
        return name  # `find_companion` tries the code pages


def _unreadable(error: Exception) -> ProblemError:
    return _rejected(f"the zip cannot be read: {error}; pack it again without a password, deflated or stored")


def _check(entries: list[zipfile.ZipInfo], archive_bytes: int) -> int:
    """Refuse entries that an upload never needs; return the declared size, which `_unpack_one` enforces."""
    if not 1 <= len(entries) <= MAX_FILES:
        raise _rejected(f"the zip has {len(entries)} files; 1 to {MAX_FILES} are allowed")
    names = [entry.filename for entry in entries]
    if len(set(names)) < len(names):
        raise _rejected("the zip names a file twice; pack each once")
    for entry in entries:
        path = PurePosixPath(entry.filename)
        if (
            not path.parts
            or path.is_absolute()
            or ".." in path.parts
            or "\0" in entry.filename
            or path.parts[0].endswith(":")
        ):
            raise _rejected(f"the zip names {entry.filename!r}, which leads outside of it; use relative names")
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise _rejected(f"{entry.filename!r} is a symbolic link; pack the file itself")
        if path.suffix.lower() in ARCHIVE_SUFFIXES:
            raise _rejected(f"{entry.filename!r} is an archive in the archive; pack its files themselves")
    declared = sum(entry.file_size for entry in entries)
    if declared > MAX_UNPACKED_BYTES or declared > MAX_RATIO * archive_bytes:
        allowed = min(MAX_UNPACKED_BYTES, MAX_RATIO * archive_bytes)
        raise _rejected(f"the zip unpacks to {declared:,} bytes; at most {allowed:,} ({MAX_RATIO}:1) are allowed")
    return declared


def _unpack_one(opened: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path, left: int) -> ReceivedFile:
    digest = sha256()
    size = 0
    with opened.open(entry) as source, path.open("xb") as target:
        while chunk := source.read(CHUNK_BYTES):
            size += len(chunk)
            if size > min(entry.file_size, left):
                raise _rejected(f"{entry.filename!r} unpacks to more than it declares, or all to more than is allowed")
            digest.update(chunk)
            target.write(chunk)
    return ReceivedFile(name=entry.filename, path=path, sha256=digest.hexdigest(), bytes=size)


def _rejected(detail: str) -> ProblemError:
    return ProblemError("archive-rejected", detail)
