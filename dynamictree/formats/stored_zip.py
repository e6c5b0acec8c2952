"""ZIP archives as streams: stored, zip64, the same bytes for the same files.

A file's checksum is known before its first byte goes out, so that no data descriptors are needed and every reader
that streams can follow. Python's zipfile writes descriptors to a stream that cannot seek, hence the few records here
(PKWARE's APPNOTE 6.3, sections 4.3.7, 4.3.12, 4.3.14 to 4.3.16).
"""

import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

_VERSION = 45  # of ZIP, the first with zip64
_NO_TIME, _FIRST_DAY = 0, 1 << 5 | 1  # 1980-01-01: bytes do not depend on the clock
_IN_ZIP64, _MANY = 0xFFFFFFFF, 0xFFFF


@dataclass(frozen=True, kw_only=True)
class _Entry:
    name: bytes
    crc: int
    size: int
    start: int  # of the local header in the archive


def iter_stored_zip(files: Iterable[tuple[str, Sequence[bytes]]]) -> Iterator[bytes]:
    """Chunks of the archive. Files are name and content in parts, and are asked for one by one."""
    entries: list[_Entry] = []
    place = 0
    for name, parts in files:
        crc = 0
        for part in parts:
            crc = zlib.crc32(part, crc)
        entry = _Entry(name=name.encode(), crc=crc, size=sum(map(len, parts)), start=place)
        entries.append(entry)
        local = _local_header(entry)
        yield local
        yield from parts
        place += len(local) + entry.size
    yield _directory(entries, place)


def _local_header(entry: _Entry) -> bytes:
    extra = struct.pack("<HHQQ", 1, 16, entry.size, entry.size)
    fixed = struct.pack(
        "<4s5H3I2H",
        b"PK\x03\x04", _VERSION, 0, 0, _NO_TIME, _FIRST_DAY,
        entry.crc, _IN_ZIP64, _IN_ZIP64,
        len(entry.name), len(extra),
    )  # fmt: skip
    return fixed + entry.name + extra


def _directory(entries: list[_Entry], start: int) -> bytes:
    records = b"".join(_central_header(entry) for entry in entries)
    count, size = len(entries), len(records)
    zip64_end = struct.pack("<4sQ2H2I4Q", b"PK\x06\x06", 44, _VERSION, _VERSION, 0, 0, count, count, size, start)
    locator = struct.pack("<4sIQI", b"PK\x06\x07", 0, start + size, 1)
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, _MANY, _MANY, _IN_ZIP64, _IN_ZIP64, 0)
    return records + zip64_end + locator + end


def _central_header(entry: _Entry) -> bytes:
    readable = 0o100644 << 16
    extra = struct.pack("<HHQQQ", 1, 24, entry.size, entry.size, entry.start)
    creator_version = 3 << 8 | _VERSION  # Unix, so that the permissions are read
    fixed = struct.pack(
        "<4s6H3I5H2I",
        b"PK\x01\x02", creator_version, _VERSION, 0, 0, _NO_TIME, _FIRST_DAY,
        entry.crc, _IN_ZIP64, _IN_ZIP64,
        len(entry.name), len(extra), 0, 0, 0,
        readable, _IN_ZIP64,
    )  # fmt: skip
    return fixed + entry.name + extra
