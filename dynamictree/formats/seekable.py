"""Streams of which the size is known before anything is read."""

import os
from typing import Protocol, runtime_checkable

from dynamictree.byte_stream import ByteReader


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
