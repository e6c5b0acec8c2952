"""STL, binary and ASCII. Triangles in a file share no vertices; equal positions are merged, in the file's order."""

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.number_text import rows_of
from dynamictree.formats.origin import offset_warnings, shift_to_origin
from dynamictree.mesh import MAX_FACES, TriangleMesh
from dynamictree.source import Source


def read_stl(content: bytes) -> TriangleMesh:
    """Read a mesh in the file's axes and units.

    Raises:
        FormatError: truncated, or neither kind of STL.
        MeshError: more faces than `mesh.py` allows.
    """
    corners = _ascii_corners(content) if is_ascii_stl(content) else _binary_corners(content)
    points, offset = shift_to_origin(corners.reshape(-1, 3).astype(np.float64))
    # adding zero makes -0 and 0 the same bytes
    keys = np.ascontiguousarray(points + np.float32(0)).view("V12").ravel()
    positions, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    vertices = positions[order].view(np.float32).reshape(-1, 3)
    faces = rank[inverse.ravel()].reshape(-1, 3)
    return TriangleMesh(
        vertices=vertices, faces=faces, source=Source(up_axis="+Z", offset=offset), warnings=offset_warnings(offset)
    )


def is_ascii_stl(head: bytes) -> bool:
    """Whether a file begins as ASCII STL; some binary files begin with `solid` too, but have no facet soon after."""
    return head.lstrip()[:5].lower() == b"solid" and b"facet" in head[:1024].lower()


def _binary_corners(content: bytes) -> Float32[np.ndarray, "F 3 3"]:
    header_bytes = 84
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    if len(content) < header_bytes:
        raise FormatError(f"the STL file has {len(content)} bytes; its header alone has {header_bytes}")
    count = int.from_bytes(content[80:84], "little")
    _refuse_too_many(count)
    needed = header_bytes + count * record.itemsize
    if needed > len(content):
        raise FormatError(
            f"the STL header says {count:,} faces, {needed:,} bytes, but {len(content):,} are there; "
            "it is truncated or no STL"
        )
    records = np.frombuffer(content, record, count, header_bytes)
    return np.ascontiguousarray(records["corners"]).astype(np.float32)


def _ascii_corners(content: bytes) -> Float64[np.ndarray, "F 3 3"]:
    words = content.lower().split(b"vertex")
    _refuse_too_many((len(words) - 1) // 3)
    rows = [word.split(maxsplit=3)[:3] for word in words[1:]]
    corners = rows_of(b" ".join(number for row in rows for number in row), 9)
    if corners is None or len(rows) % 3 or len(corners) != len(rows) // 3:
        raise FormatError(
            "the ASCII STL file has facets that have not three vertices of three numbers; it is truncated"
        )
    return corners.reshape(-1, 3, 3)


def _refuse_too_many(count: int) -> None:
    if count > MAX_FACES:
        raise MeshError(f"the STL file has {count:,} faces; at most {MAX_FACES:,} are allowed; decimate it first")
