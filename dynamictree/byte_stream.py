"""What readers and writers ask of a stream; an open binary file and `io.BytesIO` both do."""

from typing import Protocol, runtime_checkable

from dynamictree.errors import FormatError


@runtime_checkable
class ByteReader(Protocol):
    """A source of bytes."""

    def read(self, size: int = -1, /) -> bytes:
        """At most `size` bytes, all that is left if negative."""


@runtime_checkable
class ByteWriter(Protocol):
    """A sink of bytes."""

    def write(self, content: bytes, /) -> object:
        """Take all of `content`."""


def read_all(stream: ByteReader, max_bytes: int) -> bytes:
    """The rest of a stream.

    Raises:
        FormatError: it holds more than `max_bytes`.
    """
    content = stream.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise FormatError(f"the file is larger than the {max_bytes:,} bytes that are allowed")
    return content
