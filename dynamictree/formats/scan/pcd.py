"""Point clouds of the Point Cloud Library (.pcd, version 0.7): ASCII and binary; compressed ones are refused."""

import numpy as np
from jaxtyping import UInt8

from dynamictree.errors import FormatError
from dynamictree.formats.ply_table import PlyElement, PlyHeader, read_elements
from dynamictree.formats.scan.points import Scan
from dynamictree.formats.seekable import SeekableReader
from dynamictree.gaussian.cloud import check_count

_KINDS = {"F": "f", "I": "i", "U": "u"}
_COLOR = ("rgb", "rgba")


def read_pcd(stream: SeekableReader) -> Scan:
    """Read x, y, z and, if present, `rgb`; points that are not finite are missing measurements.

    Raises:
        FormatError: not PCD, compressed, no positions, shorter than its header says.
        InputError: too many points.
    """
    header = _read_header(stream)
    check_count(header.elements[0].count)
    (rows,) = read_elements(stream, header, "points")
    points = np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1)
    name = next((name for name in _COLOR if name in header.elements[0].names), None)
    return Scan(points=points, colors=None if name is None else _colors(rows[name]))


def _read_header(stream: SeekableReader) -> PlyHeader:
    """Read the header as that of a PLY file with one element; a field of several numbers becomes several properties."""
    allowed_sizes = {"f": (4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8)}
    max_header_bytes = 64 * 1024
    max_width = 10_000  # numbers per point
    entries: dict[str, list[str]] = {}
    while "DATA" not in entries:
        line = stream.readline(max_header_bytes)
        if not line or stream.tell() > max_header_bytes:
            raise FormatError("the PCD file's header has no line DATA; the file is truncated or none of version 0.7")
        words = line.decode("utf-8", "replace").split()
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
    try:
        names, kinds = entries["FIELDS"], [_KINDS[kind] for kind in entries["TYPE"]]
        sizes, widths = (
            [int(size) for size in entries["SIZE"]],
            [int(n) for n in entries.get("COUNT", ["1"] * len(names))],
        )
        count, coding = int(entries["POINTS"][0]), entries["DATA"][0].lower()
        columns = list(zip(names, kinds, sizes, widths, strict=True))
    except (KeyError, ValueError, IndexError) as error:
        raise FormatError(f"the PCD file's header is damaged: {error}") from error
    if any(size not in allowed_sizes[kind] or width < 1 for _, kind, size, width in columns) or sum(widths) > max_width:
        raise FormatError("the PCD file's header has fields of a size that there is not")
    if not {"x", "y", "z"} <= {name for name, _, _, width in columns if width == 1}:
        raise FormatError(f"the PCD file's fields are {', '.join(names)[:200]}; x, y and z are needed")
    if coding not in ("ascii", "binary"):
        raise FormatError(
            f"the PCD file's data are {coding[:30]!r}; ascii and binary are read: convert it with "
            "`pcl_convert_pcd_ascii_binary in.pcd out.pcd 1`"
        )
    properties = tuple(  # padding fields are all called `_`; no name in the file has a blank
        (name if width == 1 and names.index(name) == field else f"{field} {number}", f"{kind}{size}")
        for field, (name, kind, size, width) in enumerate(columns)
        for number in range(width)
    )
    encoding = "ascii" if coding == "ascii" else "binary_little_endian"
    return PlyHeader(encoding=encoding, elements=(PlyElement(name="points", count=count, properties=properties),))


def _colors(packed: np.ndarray) -> UInt8[np.ndarray, "G 3"]:
    """Unpack red, green and blue from integers 0xRRGGBB, which PCL often stores as the bits of a float."""
    bits = packed.view(np.uint32) if packed.dtype == np.float32 else packed.astype(np.uint32)
    colors: UInt8[np.ndarray, "G 3"] = np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=1).astype(
        np.uint8
    )
    return colors
