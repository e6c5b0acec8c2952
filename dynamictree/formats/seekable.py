"""Seekable streams: their size before anything is read, and a limit of the compression ratio."""

import os
from typing import Protocol, runtime_checkable

from dynamictree.byte_stream import ByteReader
from dynamictree.errors import FormatError

MAX_RATIO = 100
"""Largest ratio of unpacked to packed bytes: clouds of real trees are below 5, only zeros reach 1000."""


@runtime_checkable
class SeekableReader(ByteReader, Protocol):
    """A source of bytes that can seek, such as an open binary file or `io.BytesIO`."""

    def readline(self, size: int = -1, /) -> bytes:
        """Read up to and including the next line feed, at most `size` bytes."""

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Change the position; return the new one."""

    def tell(self) -> int:
        """Return the position."""


def remaining_bytes(stream: SeekableReader) -> int:
    """Return the number of bytes from a stream's position to its end."""
    position = stream.tell()
    end = stream.seek(0, os.SEEK_END)
    stream.seek(position)
    return end - position


def refuse_bomb(what: str, unpacked_bytes: int, packed_bytes: int) -> None:
    """Check the declared size of a packed file before it is unpacked; `what` names the file in the message.

    Raises:
        FormatError: it would become more than 16 MiB and more than `MAX_RATIO` times as large.
    """
    always_bytes = 16 << 20  # allowed at any ratio
    if unpacked_bytes > max(MAX_RATIO * packed_bytes, always_bytes):
        raise FormatError(
            f"{what} would unpack {packed_bytes:,} to {unpacked_bytes:,} bytes; at most {MAX_RATIO}:1 is allowed"
        )
