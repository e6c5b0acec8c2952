"""Streams of which the size is known before anything is read."""

import os
from typing import Protocol, runtime_checkable

from dynamictree.byte_stream import ByteReader
from dynamictree.errors import FormatError

MAX_RATIO = 100
"""Unpacked over packed bytes: clouds of real trees are below 5, nothing but zeros is at 1000."""


@runtime_checkable
class SeekableReader(ByteReader, Protocol):
    """A source of bytes that can go back; an open binary file and `io.BytesIO` both can."""

    def readline(self, size: int = -1, /) -> bytes:
        """Up to and with the next line feed, at most `size` bytes."""

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Go to a place; gives the place."""

    def tell(self) -> int:
        """The place."""


def remaining_bytes(stream: SeekableReader) -> int:
    """From where a stream stands to its end."""
    position = stream.tell()
    end = stream.seek(0, os.SEEK_END)
    stream.seek(position)
    return end - position


def refuse_bomb(what: str, unpacked_bytes: int, packed_bytes: int) -> None:
    """Check what a packed file says of its size before it is unpacked; `what` names the file in the message.

    Raises:
        FormatError: it would become more than 16 MiB and more than `MAX_RATIO` times as large.
    """
    always_bytes = 16 << 20  # whatever the ratio
    if unpacked_bytes > max(MAX_RATIO * packed_bytes, always_bytes):
        raise FormatError(
            f"{what} would unpack {packed_bytes:,} to {unpacked_bytes:,} bytes; at most {MAX_RATIO}:1 is allowed"
        )
