"""Streams are read to their end, within a limit, and in no more memory than their content needs."""

import io
import tracemalloc

import pytest

from dynamictree.byte_stream import CHUNK_BYTES, read_all
from dynamictree.errors import FormatError


@pytest.mark.parametrize("size", [0, 1, CHUNK_BYTES, 2 * CHUNK_BYTES + 1])
def test_all_is_read_up_to_the_limit(size: int) -> None:
    content = bytes(range(256)) * (size // 256) + bytes(size % 256)
    assert read_all(io.BytesIO(content), size) == content
    with pytest.raises(FormatError, match="larger"):
        read_all(io.BytesIO(content + b"x"), size)


def test_a_small_file_takes_little_memory_below_a_large_limit(tmp_path) -> None:
    path = tmp_path / "tree.obj"
    path.write_bytes(b"v 0 0 0\n")
    with path.open("rb") as stream:
        tracemalloc.start()
        read_all(stream, 1 << 30)
        _, most_bytes = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert most_bytes < 8 * CHUNK_BYTES
