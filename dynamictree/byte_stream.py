"""Protocols of the streams that readers and writers accept, such as an open binary file or `io.BytesIO`."""

import io
from typing import Protocol, runtime_checkable

from dynamictree.errors import FormatError

CHUNK_BYTES = 1 << 20
"""Largest size of one read: `read(n)` of an open file allocates n bytes, even if the file is shorter."""


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
    content = io.BytesIO()
    while chunk := stream.read(min(CHUNK_BYTES, max_bytes + 1 - content.tell())):
        content.write(chunk)
    if content.tell() > max_bytes:
        raise FormatError(f"the file is larger than the {max_bytes:,} bytes that are allowed")
    return content.getvalue()
