"""Check a LAS header before laspy and lazrs trust it: false counts cost minutes, all memory, or a crash.

LAS 1.4 R15, sections 2.4 and 2.5; the chunk table is LASzip's.
"""

import struct

from dynamictree.errors import FormatError
from dynamictree.formats.seekable import SeekableReader

HEADER_BYTES = 227  # of version 1.2, the shortest that is read
_VLR_BYTES, _EVLR_BYTES = 54, 60
_EVLRS_AT, _HEADER_1_4_BYTES = 235, 375
_COMPRESSED = 0x80  # set in the point format of LAZ


def check_las_header(stream: SeekableReader, size: int) -> None:
    """Hold the header's counts against the file's size; the stream is left where it stood.

    Raises:
        FormatError: a count that the file has no room for.
    """
    start = stream.tell()
    head = stream.read(_HEADER_1_4_BYTES)
    if len(head) < HEADER_BYTES or head[:4] != b"LASF":
        raise FormatError(f"the file is {size} bytes and begins with {head[:4]!r}; it is no LAS file, or truncated")
    header_bytes, points_at, num_vlrs, point_format, row_bytes = struct.unpack_from("<HIIBH", head, 94)
    if not header_bytes <= points_at <= size:
        raise FormatError(f"the points begin at byte {points_at:,} of {size:,}; the LAS header is damaged")
    _require_room("records", num_vlrs, _VLR_BYTES, points_at - header_bytes)
    if head[25] >= 4 and header_bytes >= _HEADER_1_4_BYTES and len(head) == _HEADER_1_4_BYTES:
        evlrs_at, num_evlrs = struct.unpack_from("<QI", head, _EVLRS_AT)
        _require_room("extended records", num_evlrs, _EVLR_BYTES, max(size - evlrs_at, 0))
    if point_format & _COMPRESSED:
        _check_chunks(stream, start, points_at, row_bytes, size)
    stream.seek(start)


def _check_chunks(stream: SeekableReader, start: int, points_at: int, row_bytes: int, size: int) -> None:
    stream.seek(start + points_at)
    stored = stream.read(8)
    table_at = int.from_bytes(stored, "little", signed=True)
    if len(stored) == 8 and table_at == -1:  # written to a pipe: the offset stands at the end
        stream.seek(start + size - 8)
        table_at = int.from_bytes(stream.read(8), "little", signed=True)
    if not points_at + len(stored) <= table_at <= size - 8:
        raise FormatError(f"the chunks of the LAZ file are listed at byte {table_at:,} of {size:,}; it is damaged")
    stream.seek(start + table_at + 4)
    num_chunks = int.from_bytes(stream.read(4), "little")
    _require_room("chunks", num_chunks, max(row_bytes, 1), table_at - points_at)  # each begins with a whole point


def _require_room(what: str, count: int, each: int, room: int) -> None:
    if count * each > room:
        raise FormatError(
            f"the LAS header tells of {count:,} {what}; in {room:,} bytes there is no room; it is damaged"
        )
