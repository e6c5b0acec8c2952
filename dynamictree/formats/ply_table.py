"""PLY files as tables: a header, then for each element its rows of named scalars.

Only what clouds need: lists (faces) are recognised in the header and refused as data.
"""

import math
import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped

from dynamictree.axis_names import UP_AXIS_PATTERN
from dynamictree.errors import FormatError
from dynamictree.formats.number_text import rows_of
from dynamictree.formats.origin import Offset
from dynamictree.formats.seekable import SeekableReader, remaining_bytes

_MAX_HEADER = 65_536  # bytes; the largest in use, 3DGS with SH 3, is 1.5 kB
_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "<"}


@dataclass(frozen=True, kw_only=True)
class PlyElement:
    """One table of the file."""

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
        """Up axis that a comment names, as our own writers and Nerfstudio do; None if none does.

        A `Vertical axis: y` says nothing: Brush writes it into every splat, also where -Y is up.
        """
        named = next((axis for axis in self._comment_values("up_axis") if re.fullmatch(UP_AXIS_PATTERN, axis)), None)
        return named or ("+Z" if "vertical axis: z" in (comment.lower() for comment in self.comments) else None)

    @property
    def unit_m(self) -> float | None:
        """Metres per unit that a comment names; None if none does."""
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
        """The element of that name, if there is one."""
        return next((element for element in self.elements if element.name == name), None)


def axis_comments(up_axis: str, unit_m: float, offset: Offset = (0.0, 0.0, 0.0)) -> list[str]:
    """Header lines that say the up axis and the unit, which `PlyHeader` reads back, and how the source was shifted."""
    shift = [f"comment source_offset {' '.join(f'{number:.0f}' for number in offset)}"] if any(offset) else []
    return [f"comment up_axis {up_axis}", f"comment unit_m {unit_m:.9g}", *shift]


def read_header(stream: SeekableReader) -> PlyHeader:
    """Read up to and with `end_header`.

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
    """The rows of some elements, as structured arrays in this machine's byte order; the file is read no further.

    Raises:
        FormatError: the file is shorter than its header says, or an element with lists stands before or among them.
    """
    wanted = dict[str, Shaped[np.ndarray, " rows"]]()
    order = _BYTE_ORDERS[header.encoding]
    for element in header.elements:
        if len(wanted) == len(names):
            break
        if element.has_lists:
            raise FormatError(f"element {element.name!r} of the PLY file has lists; a cloud has single numbers only")
        layout = np.dtype([(name, order + kind) for name, kind in element.properties])
        rows = (
            _ascii_rows(stream, element, layout)
            if header.encoding == "ascii"
            else _binary_rows(stream, element, layout)
        )
        if element.name in names:
            wanted[element.name] = rows
    return [wanted[name] for name in names]


def _binary_rows(stream: SeekableReader, element: PlyElement, layout: np.dtype[np.void]) -> Shaped[np.ndarray, " rows"]:
    needed, available = element.count * layout.itemsize, remaining_bytes(stream)
    if needed > available:
        raise FormatError(
            f"the PLY header says {element.count:,} rows of {layout.itemsize} bytes in {element.name!r}, {needed:,} "
            f"bytes, but {available:,} are left in the file; it is truncated or its header is wrong"
        )
    rows = np.frombuffer(stream.read(needed), layout)
    return rows.astype(layout.newbyteorder("="), copy=False)


def _ascii_rows(stream: SeekableReader, element: PlyElement, layout: np.dtype[np.void]) -> Shaped[np.ndarray, " rows"]:
    shortest = element.count * 2 * len(element.properties)  # a digit and a space a number
    if shortest > remaining_bytes(stream) + 1:
        raise FormatError(
            f"the PLY header says {element.count:,} rows in {element.name!r}, at least {shortest:,} bytes, "
            f"but {remaining_bytes(stream):,} are left in the file; it is truncated or its header is wrong"
        )
    text = b"".join(stream.readline() for _ in range(element.count))
    table = rows_of(text, max(len(element.properties), 1))
    if table is None or len(table) != element.count:
        raise FormatError(f"the rows of element {element.name!r} of the PLY file do not fit its header")
    rows = np.empty(element.count, layout)
    with np.errstate(over="ignore", invalid="ignore"):
        for column, (name, _) in enumerate(element.properties):
            rows[name] = table[:, column]
    return rows


def _header_lines(stream: SeekableReader) -> list[str]:
    if stream.readline(64).removeprefix(b"\xef\xbb\xbf").strip() != b"ply":
        raise FormatError("the file does not begin with 'ply'; it is no PLY file")
    lines, size = list[str](), 4
    while True:
        line = stream.readline(_MAX_HEADER)
        size += len(line)
        if not line.endswith(b"\n") or size > _MAX_HEADER:
            raise FormatError(
                f"the PLY header has no end within {_MAX_HEADER:,} bytes; the file is truncated or no PLY"
            )
        text = line.decode("latin-1").strip()
        if text == "end_header":
            return lines
        lines.append(text)


def _is_property(words: list[str]) -> bool:
    if words[1] == "list":
        return len(words) == 5 and words[2] in _TYPES and words[3] in _TYPES
    return len(words) == 3 and words[1] in _TYPES
