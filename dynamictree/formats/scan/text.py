"""Point clouds as text: XYZ, TXT, CSV, ASC and PTS, with columns in any order."""

import re

import numpy as np
from jaxtyping import Bool, Float64

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.number_text import numbers_of, rows_of
from dynamictree.formats.scan.points import Scan, find_color_columns
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.gaussian.cloud import MAX_GAUSSIANS, check_count

_AXIS_NAMES = tuple(
    re.compile(rf"(p|pos|point|coord|coordinate|cart|local)?{axis}(m|coord|coordinate|pos)?|{other}")
    for axis, other in (
        ("x", "easting|east|rechtswert"),
        ("y", "northing|north|hochwert"),
        ("z", "height|elevation|altitude|hoehe"),
    )
)
_COLOR_NAMES = tuple(
    re.compile(rf"{color[0]}f?|(diffuse|colou?r|vertex|scalar)?({color}|{color[0]})(8|16|colou?r|value)?")
    for color in ("red", "green", "blue")
)
_UMLAUTS = {ord("ä"): "ae", ord("ö"): "oe", ord("ü"): "ue"}
_COMMENT = re.compile(rb"[ \t]*(#|//|;|%|!)+")
_HEAD_BYTES = 1 << 16


def read_points_text(stream: SeekableReader) -> Scan:
    """Read lines of numbers, separated by blanks, tabs, commas, semicolons or bars.

    Lines before the first number are skipped; the last of them that names x, y and z, commented or not, sets the
    columns. Without names the first three columns are x, y and z, and a colour is detected by its range.
    Rows that are not finite, and rows of zeros where a scanner measured nothing, are left out.

    Raises:
        FormatError: lines that are not numbers, or of fewer than three; named columns without x, y and z.
        InputError: too many points.
    """
    size = remaining_bytes(stream)
    if size > 100 * MAX_GAUSSIANS:
        raise InputError(f"the text is {size:,} bytes; at most {MAX_GAUSSIANS:,} points are allowed; decimate it first")
    raw = _with_decimal_points(stream.read().removeprefix(b"\xef\xbb\xbf"))
    lines = [line for line in raw.translate(bytes.maketrans(b',;\t|"', b"     ")).splitlines() if line.strip()]
    start = next((number for number, line in enumerate(lines) if numbers_of(line) is not None), len(lines))
    head = [line for line in raw[:_HEAD_BYTES].splitlines() if line.strip()][:start]
    # PTS has the number of points before each scan
    rows = [line for line in lines[start:] if not (line.strip().isdigit() or _COMMENT.match(line))]
    check_count(len(rows))
    widths = {len(line.split()) for line in rows}
    if widths and max(widths) < 3:
        raise FormatError(f"the lines have {max(widths)} numbers; at least x, y and z are needed")
    table = rows_of(b"\n".join(rows), max(widths)) if len(widths) == 1 else None
    if table is None:
        odd = next((line for line in rows if numbers_of(line) is None), rows[-1])
        raise FormatError(f"the file is no table of numbers: a line is {odd[:80]!r}, or lines differ in length")
    places, colors = _columns(table, head)
    points = table[:, places]
    points[_is_empty(points)] = np.nan
    return Scan(points=points, colors=None if colors is None else table[:, colors])


def _is_empty(points: Float64[np.ndarray, "G 3"]) -> Bool[np.ndarray, " G"]:
    """Mask rows of zeros, if they are many or far from all other points."""
    far = 0.02  # share of the extent; neighbouring points of a scan are nearer to each other
    many = 0.05  # share of the rows; a scan has fewer points at the exact origin
    empty: Bool[np.ndarray, " G"] = (points == 0).all(axis=1)
    others = points[~empty]
    if len(others) == 0:
        return np.zeros_like(empty)
    low, high = others.min(axis=0), others.max(axis=0)
    apart = bool(np.maximum(low, -high).max() > far * (high - low).max())
    return empty if apart or empty.mean() > many else np.zeros_like(empty)


def _columns(table: Float64[np.ndarray, "G columns"], head: list[bytes]) -> tuple[list[int], list[int] | None]:
    """Find the columns of positions and of colours; refuse Gaussians, and names without x, y and z."""
    labels = 16.0  # integers up to this value are classes or returns, not colours
    for line in reversed(head):
        names = _column_names(line)
        unnamed = table.shape[1] - len(names)
        if unnamed not in (0, int(line.startswith(b'"'))):  # R writes an unnamed column of row numbers
            continue
        names = [""] * unnamed + names
        if {"scale0", "rot0"} <= set(names):
            raise FormatError("the table is of Gaussians; convert it with `splat-transform tree.csv tree.ply`")
        places = _positions(names, _AXIS_NAMES)
        if places is not None:
            return places, _positions(names, _COLOR_NAMES)
        if not _COMMENT.match(line):
            raise FormatError(
                f"the table's columns are {', '.join(names[unnamed:])[:300]}; a point cloud has columns x, y and z. Is "
                "it a table of cylinders or of measurements (QSM)? Send the points that it was made from"
            )
    return [0, 1, 2], find_color_columns(table, labels)


def _positions(names: list[str], options: tuple[re.Pattern[str], ...]) -> list[int] | None:
    """Return the column of each of three names; None if one is missing."""
    places = [next((place for place, name in enumerate(names) if option.fullmatch(name)), -1) for option in options]
    return None if min(places) < 0 else places


def _with_decimal_points(text: bytes) -> bytes:
    """Replace decimal commas by points, if the first line of numbers has them."""
    lines = text[:_HEAD_BYTES].splitlines()
    first = next((line for line in lines if line.strip() and line[:1].strip(b"-+ \t0123456789") == b""), b"")
    words = re.split(rb"[;\s]+", first.strip())
    commas = sum(b"," in word for word in words)
    is_number = all(re.fullmatch(rb"[-+]?[0-9]+(,[0-9]+)?([eE][-+]?[0-9]+)?", word) for word in words)
    return text.replace(b",", b".") if commas and is_number and len(words) >= 3 else text


def _column_names(line: bytes) -> list[str]:
    """Split a header line into names in lower case, without comment signs, units, quotes and other signs."""
    comment = _COMMENT.match(line)
    text = re.sub(r"\(.*?\)|\[.*?\]", "", line[comment.end() if comment else 0 :].decode("utf-8", "replace"))
    delimiter = next((sign for sign in ",;|\t" if sign in text), None)
    words = [re.sub(r"[^a-z0-9]", "", word.lower().translate(_UMLAUTS)) for word in text.strip().split(delimiter)]
    return words if delimiter is not None else [word for word in words if word]
