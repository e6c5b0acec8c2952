"""Point clouds of scans: PLY without faces, XYZ text, LAS and LAZ. A Gaussian a point, sized by its neighbours."""

import io
import re
import struct

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.origin import near_origin
from dynamictree.formats.ply_table import PlyHeader, read_elements, read_header
from dynamictree.formats.scan.las_header import HEADER_BYTES, check_las_header
from dynamictree.formats.scan.shading import shaded_colors
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.formats.splat.activations import harmonic_from_color
from dynamictree.gaussian.axes import to_z_up
from dynamictree.gaussian.cloud import MAX_GAUSSIANS, GaussianCloud, check_count, validate_cloud
from dynamictree.up_axis import up_rotation

UP_AXIS = "+Z"
"""Surveying instruments stand level and count heights upward."""
_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_AXIS_NAMES = (
    ("x", "xm", "px", "posx", "pointx", "xcoord", "xcoordinate", "coordx", "easting", "east", "rechtswert"),
    ("y", "ym", "py", "posy", "pointy", "ycoord", "ycoordinate", "coordy", "northing", "north", "hochwert"),
    ("z", "zm", "pz", "posz", "pointz", "zcoord", "zcoordinate", "coordz", "height", "elevation", "altitude", "hoehe"),
)
_UMLAUTS = {ord("ä"): "ae", ord("ö"): "oe", ord("ü"): "ue"}
_NUM_NEIGHBOURS = 3  # Kerbl et al. 2023, section 5.2: a Gaussian as wide as its three nearest neighbours are far
_LARGEST_SPACING = 4.0  # in medians: a stray point stays small
_OPACITY = 0.9  # surfaces that were scanned are solid; below 1, neighbours blend


def read_points_ply(stream: SeekableReader, *, up_axis: str = UP_AXIS, unit_m: float = 1.0) -> GaussianCloud:
    """Read x, y, z and, if there, a colour, of the vertices of a PLY file.

    Raises:
        FormatError: not PLY, no positions, shorter than its header says.
        InputError: values that are not finite, too many points, all at one place.
    """
    return read_points_rows(stream, read_header(stream), up_axis=up_axis, unit_m=unit_m)


def read_points_rows(stream: SeekableReader, header: PlyHeader, *, up_axis: str, unit_m: float) -> GaussianCloud:
    """The same, from behind the header."""
    vertex = header.element("vertex")
    if vertex is None or not vertex.names.issuperset("xyz"):
        raise FormatError("the PLY file has no vertices with x, y and z; it is no point cloud")
    check_count(vertex.count)
    (rows,) = read_elements(stream, header, "vertex")
    points = np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1)
    names = next((names for names in _COLORS if vertex.names.issuperset(names)), None)
    colors = None if names is None else np.stack([_byte_color(rows[name]) for name in names], axis=1)
    return to_z_up(cloud_of_points(points, colors, up_axis=up_axis), up_axis=up_axis, unit_m=unit_m)


def read_points_text(stream: SeekableReader, *, up_axis: str = UP_AXIS, unit_m: float = 1.0) -> GaussianCloud:
    """Read lines of x y z, divided by blanks, commas or semicolons; of six or more columns the last three are a colour.

    A first line that names the columns says which are x, y and z; other first lines that are not numbers, and lines
    that begin with # or //, are passed over.

    Raises:
        FormatError: lines that are not numbers, or of less than three; columns that are named, none of them x, y or z.
        InputError: values that are not finite, too many points, all at one place.
    """
    size = remaining_bytes(stream)
    if size > 100 * MAX_GAUSSIANS:
        raise InputError(f"the text is {size:,} bytes; at most {MAX_GAUSSIANS:,} points are allowed; decimate it first")
    raw = _with_decimal_points(stream.read())
    content = raw.translate(bytes.maketrans(b",;\t", b"   "))
    lines = [line for line in content.splitlines() if line.strip() and not _is_comment(line)]
    if lines and lines[0].strip().isdigit():  # PTS: the number of points stands before each scan
        lines = [line for line in lines if len(line.split()) > 1]
    names = list[str]()
    if lines and not _is_numbers(lines[0]):
        names = _column_names(next(line for line in raw.splitlines() if line.strip() and not _is_comment(line)))
        lines = lines[1:]
    check_count(len(lines))
    try:
        table = np.loadtxt(io.BytesIO(b"\n".join(lines)), np.float64, ndmin=2, comments=None)
    except ValueError as error:
        raise FormatError(f"the file is no table of numbers: {error}") from error
    if table.shape[1] < 3:
        raise FormatError(f"the lines have {table.shape[1]} numbers; at least x, y and z are needed")
    if len(names) == table.shape[1]:
        table = _named_columns(table, names)
    colors = _byte_color(table[:, -3:]) if table.shape[1] >= 6 and _looks_like_color(table[:, -3:]) else None
    return to_z_up(cloud_of_points(table[:, :3], colors, up_axis=up_axis), up_axis=up_axis, unit_m=unit_m)


def _with_decimal_points(text: bytes) -> bytes:
    """The text with points for decimal commas, where its first line of numbers has them."""
    lines = text[: 1 << 16].splitlines()
    first = next((line for line in lines if not _is_comment(line) and line[:1].strip(b"-+ \t0123456789") == b""), b"")
    words = re.split(rb"[;\s]+", first.strip())
    commas = sum(b"," in word for word in words)
    is_number = all(re.fullmatch(rb"[-+]?[0-9]+(,[0-9]+)?([eE][-+]?[0-9]+)?", word) for word in words)
    return text.replace(b",", b".") if commas and is_number and len(words) >= 3 else text


def _is_comment(line: bytes) -> bool:
    return line.lstrip().startswith((b"#", b"//"))


def _column_names(line: bytes) -> list[str]:
    """The words of a table's first line, without units, quotes and signs, in lower case."""
    text = re.sub(r"\(.*?\)|\[.*?\]", "", line.decode("utf-8", "replace"))
    delimiter = next((sign for sign in ",;\t" if sign in text), None)
    words = [re.sub(r"[^a-z0-9]", "", word.lower().translate(_UMLAUTS)) for word in text.split(delimiter)]
    return words if delimiter is not None else [word for word in words if word]


def _named_columns(table: Float64[np.ndarray, "G columns"], names: list[str]) -> Float64[np.ndarray, "G width"]:
    """The columns of positions, and of colours if there are any.

    Raises:
        FormatError: no x, y or z is named, or the rows are Gaussians.
    """
    if {"scale0", "rot0"} <= set(names):
        raise FormatError("the table is of Gaussians; convert it with `splat-transform tree.csv tree.ply`")
    places = [next((names.index(name) for name in options if name in names), None) for options in _AXIS_NAMES]
    if any(place is None for place in places):
        raise FormatError(
            f"the table's columns are {', '.join(names)[:300]}; a point cloud has columns x, y and z. Is it a table of "
            "cylinders or of measurements (QSM)? Send the points that it was made from"
        )
    color = next(([names.index(name) for name in three] for three in _COLORS if set(three) <= set(names)), [])
    columns: Float64[np.ndarray, "G width"] = table[:, [place for place in places if place is not None] + color]
    return columns


def read_las(stream: SeekableReader, *, up_axis: str = UP_AXIS, unit_m: float = 1.0) -> GaussianCloud:
    """Read LAS, or LAZ, with colours if the points have them.

    Raises:
        FormatError: not LAS, truncated, damaged.
        InputError: too many points, all at one place.
    """
    import laspy  # type: ignore[import-untyped]

    size = remaining_bytes(stream)
    if size < HEADER_BYTES:
        raise FormatError(f"the file is {size} bytes; a LAS header alone is {HEADER_BYTES}; it is truncated")
    check_las_header(stream, size)
    try:
        with laspy.open(stream, closefd=False, laz_backend=laspy.LazBackend.Lazrs) as reader:  # its one-thread twin
            check_count(reader.header.point_count)
            las = reader.read()
    except (laspy.LaspyException, struct.error, ValueError, OSError, RuntimeError) as error:
        raise FormatError(f"the LAS file cannot be read: {error}") from error
    check_count(len(las.points))
    points = np.stack([np.asarray(las.x), np.asarray(las.y), np.asarray(las.z)], axis=1).astype(np.float64)
    colors = None
    if {"red", "green", "blue"} <= set(las.point_format.dimension_names):
        colors = _byte_color(np.stack([las.red, las.green, las.blue], axis=1).astype(np.float64))
    return to_z_up(cloud_of_points(points, colors, up_axis=up_axis), up_axis=up_axis, unit_m=unit_m)


def cloud_of_points(
    points: Float64[np.ndarray, "G 3"], colors: UInt8[np.ndarray, "G 3"] | None = None, *, up_axis: str = UP_AXIS
) -> GaussianCloud:
    """A round Gaussian a point, as wide as its neighbours are far; points far from the origin are moved to it.

    Raises:
        InputError: a value that is not finite, or all points at one place.
    """
    check_count(len(points))
    if not np.isfinite(points).all():
        index = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InputError(f"point {index} is at {points[index].tolist()}; positions must be finite; remove it")
    extent = float(np.ptp(points, axis=0).max())
    if extent == 0:
        raise InputError(f"all {len(points):,} points are at one place; the cloud needs an extent")
    means, offset = near_origin(points)
    points = means.astype(np.float64)
    scales = np.repeat(_spacing(points)[:, None], 3, axis=1)
    if colors is None:
        colors = shaded_colors(points @ up_rotation(up_axis).T, spacing=2 * float(np.median(scales)))
    return validate_cloud(
        GaussianCloud(
            means=means,
            quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (len(points), 1)),
            scales=scales,
            opacity=np.full(len(points), _OPACITY, np.float32),
            sh=harmonic_from_color(colors / np.float32(255))[:, None],
            source_offset=offset,
        )
    )


def _spacing(points: Float64[np.ndarray, "G 3"]) -> Float32[np.ndarray, " G"]:
    """Half of the root mean square distance to the nearest points, not more than a few medians [the points' unit]."""
    from scipy.spatial import KDTree  # 0.3 s that readers of other formats do without

    num_neighbours = min(_NUM_NEIGHBOURS, len(points) - 1)
    distances = np.asarray(KDTree(points).query(points, num_neighbours + 1, workers=-1)[0])  # [G, 1 + neighbours]
    spacing = np.sqrt((distances[:, 1:] ** 2).mean(axis=1))
    typical = np.median(spacing[spacing > 0]) if (spacing > 0).any() else np.ptp(points, axis=0).max()
    result: Float32[np.ndarray, " G"] = (0.5 * np.clip(spacing, 0.1 * typical, _LARGEST_SPACING * typical)).astype(
        np.float32
    )
    return result


def _byte_color(values: np.ndarray) -> UInt8[np.ndarray, "..."]:
    """Colours of 16 bits and of floats in [0, 1] to 8 bits; the largest value decides which they are."""
    largest = float(values.max(initial=0))
    if values.dtype.kind == "f" and largest <= 1:
        values = values * 255.0
    elif largest > 255:
        values = values / 257.0
    result: UInt8[np.ndarray, ...] = np.clip(np.nan_to_num(values), 0, 255).astype(np.uint8)
    return result


def _looks_like_color(values: Float64[np.ndarray, "G 3"]) -> bool:
    return bool(values.min() >= 0 and values.max() <= 65_535)


def _is_numbers(line: bytes) -> bool:
    try:
        [float(word) for word in line.split()]
    except ValueError:
        return False
    return True
