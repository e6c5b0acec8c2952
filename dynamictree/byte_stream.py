"""Protocols of the streams that readers and writers accept, such as an open binary file or `io.BytesIO`."""

from typing import Protocol, runtime_checkable

from dynamictree.errors import FormatError


@runtime_checkable
class ByteReader(Protocol):
    """A source of bytes."""

    def read(self, size: int = -1, /) -> bytes:
        """Return at most `size` bytes; all remaining bytes if `size` is negative."""


@runtime_checkable
class ByteWriter(Protocol):
    """A sink of bytes."""

    def write(self, content: bytes, /) -> object:
        """Write all of `content`."""


def read_all(stream: ByteReader, max_bytes: int) -> bytes:
    """Read the rest of a stream.

    Raises:
        FormatError: it holds more than `max_bytes`.
    """
    content = stream.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise FormatError(f"the file is larger than the {max_bytes:,} bytes that are allowed")
    return content
