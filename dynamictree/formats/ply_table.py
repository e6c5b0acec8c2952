"""PLY files as tables: a header, then for each element its rows of named scalars and lists.

ASCII files are converted to binary with all numbers as doubles.
"""

import io
import math
import re
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from jaxtyping import Int32, Int64, Shaped

from dynamictree.axis_names import UP_AXIS_PATTERN
from dynamictree.errors import FormatError
from dynamictree.formats.number_text import numbers_of
from dynamictree.formats.origin import Offset
from dynamictree.formats.seekable import SeekableReader, remaining_bytes

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "<"}
_Property = tuple[str, list[np.dtype[np.generic]]]


@dataclass(frozen=True, kw_only=True)
class PlyElement:
    """Description of one table of the file."""

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]  # name and numpy type without byte order; "list u1 i4" for lists

    @property
    def names(self) -> frozenset[str]:
        """Names of the properties."""
        return frozenset(name for name, _ in self.properties)

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in length."""
        return any(kind.startswith("list") for _, kind in self.properties)


@dataclass(frozen=True, kw_only=True)
class PlyHeader:
    """Parsed header; the data begin at the stream's position after `read_header`."""

    encoding: str
    elements: tuple[PlyElement, ...]
    comments: tuple[str, ...] = ()

    @property
    def up_axis(self) -> str | None:
        """Up axis from a comment, as our own writers and Nerfstudio write it; None if there is none.

        `Vertical axis: y` is ignored: Brush writes it into every splat, also where -Y is up.
        """
        named = next((axis for axis in self._comment_values("up_axis") if re.fullmatch(UP_AXIS_PATTERN, axis)), None)
        return named or ("+Z" if "vertical axis: z" in (comment.lower() for comment in self.comments) else None)

    @property
    def unit_m(self) -> float | None:
        """Metres per unit from a comment; None if there is none."""
        for value in self._comment_values("unit_m"):
            try:
                unit = float(value)
            except ValueError:
                continue
            if math.isfinite(unit) and unit > 0:
                return unit
        return None

    def _comment_values(self, name: str) -> list[str]:
        words = [comment.split() for comment in self.comments]
        return [each[1] for each in words if len(each) == 2 and each[0] == name]

    def element(self, name: str) -> PlyElement | None:
        """Return the element of that name, if there is one."""
        return next((element for element in self.elements if element.name == name), None)


def axis_comments(up_axis: str, unit_m: float, offset: Offset = (0.0, 0.0, 0.0)) -> list[str]:
    """Return header lines with the up axis and unit, which `PlyHeader` reads back, and the source's offset."""
    shift = [f"comment source_offset {' '.join(f'{number:.0f}' for number in offset)}"] if any(offset) else []
    return [f"comment up_axis {up_axis}", f"comment unit_m {unit_m:.9g}", *shift]


def read_header(stream: SeekableReader) -> PlyHeader:
    """Read the header, up to and including `end_header`.

    Raises:
        FormatError: not a PLY file, or a header that breaks the format's rules.
    """
    lines = _header_lines(stream)
    encoding, elements, comments = "", list[PlyElement](), list[str]()
    for line in lines:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            comments.append(" ".join(words[1:]))
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _BYTE_ORDERS:
            encoding = words[1]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal() and len(words[2]) <= 12:
            elements.append(PlyElement(name=words[1], count=int(words[2]), properties=()))
        elif words[0] == "property" and elements and _is_property(words):
            kind = " ".join(["list", *(_TYPES[w] for w in words[2:4])]) if words[1] == "list" else _TYPES[words[1]]
            last = elements[-1]
            if words[-1] in last.names:
                raise FormatError(
                    f"the PLY header names property {words[-1]!r} of {last.name!r} twice; names must differ"
                )
            properties = (*last.properties, (words[-1], kind))
            elements[-1] = PlyElement(name=last.name, count=last.count, properties=properties)
        else:
            raise FormatError(f"the PLY header has a line that is not understood: {line[:80]!r}")
    if not encoding or not elements:
        raise FormatError("the PLY header names no format or no element; it needs both")
    return PlyHeader(encoding=encoding, elements=tuple(elements), comments=tuple(comments))


def read_elements(stream: SeekableReader, header: PlyHeader, *names: str) -> list[Shaped[np.ndarray, " rows"]]:
    """Read the rows of some elements as structured arrays in native byte order, and nothing after them.

    Raises:
        FormatError: the file is shorter than its header says, or an element with lists stands before or among them.
    """
    body, wanted = _body(stream, header), dict[str, Shaped[np.ndarray, " rows"]]()
    for element in header.elements:
        if len(wanted) == len(names):
            break
        rows = _rows(body, header, element)
        if element.name in names:
            wanted[element.name] = rows
    return [wanted[name] for name in names]


def read_polygons(
    stream: SeekableReader, header: PlyHeader, names: tuple[str, ...]
) -> tuple[Shaped[np.ndarray, " N"], Int32[np.ndarray, " C"], Int64[np.ndarray, " P"]]:
    """Read the rows of the vertices, the concatenated corners of all faces, and the number of corners of each.

    `names` are the names that the list of corners may have.

    Raises:
        FormatError: the file is shorter than its header says, or a face is invalid.
    """
    body, vertices = _body(stream, header), None
    before = takewhile(lambda one: one.name != "face", header.elements)
    for element in before:
        rows = _rows(body, header, element)
        vertices = rows if element.name == "vertex" else vertices
    face = header.element("face")
    if vertices is None or face is None:
        raise FormatError("the PLY file has its faces before its vertices; write the vertices first")
    kinds = dict(face.properties)
    name = next((name for name in names if kinds.get(name, "").startswith("list")), None)
    if name is None:
        raise FormatError(f"the faces of the PLY file have no {' or '.join(names)}; they have {sorted(kinds)[:8]}")
    corners, sizes = _lists(body.read(), _layout(header, face), face, name)
    if sizes.min() < 3:
        row = int(sizes.argmin())
        raise FormatError(f"face {row:,} of the PLY file has {sizes[row]} corners; at least 3 are needed")
    whole = corners.dtype.kind in "iu" or (header.encoding == "ascii" and bool((corners == np.round(corners)).all()))
    if not whole or np.abs(corners.astype(np.float64)).max() > np.iinfo(np.int32).max:
        raise FormatError("a face of the PLY file holds what is no index of a vertex")
    return vertices, corners.astype(np.int32), sizes


def _body(stream: SeekableReader, header: PlyHeader) -> SeekableReader:
    """Return the data after the header; numbers of an ASCII file become doubles."""
    if header.encoding != "ascii":
        return stream
    size = remaining_bytes(stream)
    least = sum(2 * element.count * len(element.properties) for element in header.elements)  # a digit and a space each
    if least > size + 1:
        counts = ", ".join(f"{element.count:,} rows in {element.name!r}" for element in header.elements)
        raise FormatError(f"the header says {counts}, at least {least:,} bytes, but {size:,} follow; it is truncated")
    numbers = numbers_of(stream.read())
    if numbers is None:
        raise FormatError("the rows of the file hold what is no number")
    return io.BytesIO(numbers.tobytes())


def _layout(header: PlyHeader, element: PlyElement) -> list[_Property]:
    """Return the name and stored types of each property; a list has two, of its length and of its items."""
    order, ascii_text = _BYTE_ORDERS[header.encoding], header.encoding == "ascii"
    kinds = [(name, kind.removeprefix("list ").split()) for name, kind in element.properties]
    if any(len(own) == 2 and own[0].startswith("f") for _, own in kinds):
        raise FormatError(f"a list of {element.name!r} in the PLY file has a length that is no whole number")
    return [(name, [np.dtype("<f8" if ascii_text else order + kind) for kind in own]) for name, own in kinds]


def _rows(body: SeekableReader, header: PlyHeader, element: PlyElement) -> Shaped[np.ndarray, " rows"]:
    if element.has_lists:
        raise FormatError(f"element {element.name!r} of the PLY file has lists, which only faces after all others may")
    stored = np.dtype([(name, types[0]) for name, types in _layout(header, element)])
    needed, available = element.count * stored.itemsize, remaining_bytes(body)
    if needed > available:
        each, unit = (8, "numbers") if header.encoding == "ascii" else (1, "bytes")
        raise FormatError(
            f"the header says {element.count:,} rows of {stored.itemsize // each} {unit} in {element.name!r}, "
            f"{needed // each:,} {unit}, but {available // each:,} are left in the file; it is truncated or its header "
            "is wrong"
        )
    rows = np.frombuffer(body.read(needed), stored)
    with np.errstate(over="ignore", invalid="ignore"):
        return rows.astype(np.dtype(list(element.properties)), copy=False)


def _lists(
    content: bytes, layout: list[_Property], element: PlyElement, name: str
) -> tuple[Shaped[np.ndarray, " C"], Int64[np.ndarray, " P"]]:
    """Read the items of one list in all rows, and their number per row; vectorised if all have the same number."""
    fields, lengths, at = list[tuple[str, np.dtype[np.generic], tuple[int, ...]]](), dict[str, int](), 0
    for label, types in layout:
        length = _length(content, at, types, element)
        if len(types) == 2:
            lengths[f"length of {label}"] = length
            fields.append((f"length of {label}", types[0], ()))
        fields.append((label, types[-1], (length,)))
        at = sum(dtype.itemsize * int(np.prod(shape)) for _, dtype, shape in fields)
    if at * element.count <= len(content):
        rows = np.frombuffer(content, np.dtype(fields), element.count)
        if all((rows[label] == length).all() for label, length in lengths.items()):
            return rows[name].ravel(), np.full(element.count, rows[name].shape[1], np.int64)
    items, sizes, at = [], np.zeros(element.count, np.int64), 0
    for row in range(element.count):
        for label, types in layout:
            length = _length(content, at, types, element)
            start = at + sum(dtype.itemsize for dtype in types[:-1])
            at = start + length * types[-1].itemsize
            if at > len(content):
                raise FormatError(
                    f"row {row:,} of {element.count:,} of {element.name!r} in the PLY file ends beyond it; the file is "
                    "truncated or its header is wrong"
                )
            if label == name:
                items.append(np.frombuffer(content, types[-1], length, start))
                sizes[row] = length
    return np.concatenate(items), sizes


def _length(content: bytes, at: int, types: list[np.dtype[np.generic]], element: PlyElement) -> int:
    """Return the number of items of the property at a byte offset; 1 for a scalar."""
    if len(types) == 1:
        return 1
    if at + types[0].itemsize > len(content):
        raise FormatError(
            f"the PLY file ends before a list of {element.name!r}; it is truncated or its header is wrong"
        )
    length = float(np.frombuffer(content, types[0], 1, at)[0])
    if not 0 <= length <= len(content) or length != int(length):
        raise FormatError(f"a list of {element.name!r} in the PLY file says that it has {length:g} items")
    return int(length)


def _header_lines(stream: SeekableReader) -> list[str]:
    max_header = 65_536  # bytes; the largest in use, 3DGS with SH 3, is 1.5 kB
    if stream.readline(64).removeprefix(b"\xef\xbb\xbf").strip() != b"ply":
        raise FormatError("the file does not begin with 'ply'; it is no PLY file")
    lines, size = list[str](), 4
    while True:
        line = stream.readline(max_header)
        size += len(line)
        if not line.endswith(b"\n") or size > max_header:
            raise FormatError(f"the PLY header has no end within {max_header:,} bytes; the file is truncated or no PLY")
        text = line.decode("latin-1").strip()
        if text == "end_header":
            return lines
        lines.append(text)


def _is_property(words: list[str]) -> bool:
    if words[1] == "list":
        return len(words) == 5 and words[2] in _TYPES and words[3] in _TYPES
    return len(words) == 3 and words[1] in _TYPES
