"""LAS and LAZ scans: points without noise, with the unit of the file's coordinate system.

With wrong counts in a header, laspy and lazrs take minutes or all memory, or crash; so counts are checked first
(LAS 1.4 R15, sections 2.4 and 2.5; the chunk table is LASzip's).
"""

import re
import struct
from dataclasses import dataclass

import numpy as np

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.scan.points import Scan
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.gaussian.cloud import check_count

_HEADER_BYTES = 227  # header size of version 1.2, the shortest that is read
_PROJECTION = "LASF_Projection"  # LAS 1.4 R15, section 3
_GEOGRAPHIC, _USER_DEFINED = 2, 32767
_DEGREES = (
    "the scan's coordinates are degrees of longitude and latitude; project them to metres (UTM), for instance with "
    "`pdal translate in.las out.las reprojection --filters.reprojection.out_srs=EPSG:32632`"
)
_LINEAR_UNIT = re.compile(r"(?<!ANGLE)(?:LENGTH)?UNIT\s*[\[(]\s*\"([^\"]*)\"\s*,\s*([0-9.eE+-]+)", re.IGNORECASE)
_ANGLES = re.compile(r"deg|rad|grad|gon", re.IGNORECASE)
_VERTICAL = re.compile(r"VERT_?CS|VERTCRS", re.IGNORECASE)
_GEOGRAPHIC_WKT = re.compile(r"\s*(GEOGCS|GEOGCRS|GEODCRS|GEOGRAPHICCRS|COMPD_?CS\[[^,]*,\s*GEOGCS)", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class _Units:
    """Metres per unit of x and y, and of z."""

    horizontal_m: float = 1.0
    vertical_m: float = 1.0


def read_las(stream: SeekableReader, *, unit_m: float | None = None) -> Scan:
    """Read LAS, or LAZ, with colours if the points have them.

    Points that are classified as noise or marked as withheld are left out. `unit_m` overrides the unit of the file's
    coordinate system (WKT or GeoTIFF keys).

    Raises:
        FormatError: not LAS, truncated, damaged.
        InputError: too many points, coordinates in degrees.
    """
    noise_classes = (7, 18)  # classes of low and of high noise: LAS 1.4 R15, table 17
    import laspy  # type: ignore[import-untyped]

    size = remaining_bytes(stream)
    if size < _HEADER_BYTES:
        raise FormatError(f"the file is {size} bytes; a LAS header alone is {_HEADER_BYTES}; it is truncated")
    check_las_header(stream, size)
    try:
        with laspy.open(stream, closefd=False, laz_backend=laspy.LazBackend.Lazrs) as reader:  # single-threaded
            check_count(reader.header.point_count)
            las = reader.read()
        records = {
            vlr.record_id: bytes(vlr.record_data_bytes())
            for vlr in [*las.header.vlrs, *(las.header.evlrs or [])]
            if vlr.user_id == _PROJECTION
        }
    except (laspy.LaspyException, struct.error, ValueError, OSError, RuntimeError) as error:
        raise FormatError(f"the LAS file cannot be read: {error}") from error
    check_count(len(las.points))
    units = _Units() if unit_m is not None else _units(records)
    points = np.stack([np.asarray(las.x), np.asarray(las.y), np.asarray(las.z)], axis=1).astype(np.float64)
    points[:, 2] *= units.vertical_m / units.horizontal_m
    names = set(las.point_format.dimension_names)
    colors = np.stack([las.red, las.green, las.blue], axis=1) if {"red", "green", "blue"} <= names else None
    noise = np.isin(np.asarray(las.classification), noise_classes) | (np.asarray(las.withheld) != 0)
    if not noise.all():
        points, colors = points[~noise], None if colors is None else colors[~noise]
    return Scan(points=points, colors=colors, dropped=len(noise) - len(points), unit_m=units.horizontal_m)


def _units(records: dict[int, bytes]) -> _Units:
    """Return the units of the coordinate system, metres where it states none; refuse degrees."""
    wkt_record, keys_record = 2112, 34735
    model_key, unit_key, vertical_unit_key = 1024, 3076, 4099  # GeoTIFF 1.1, section 7
    code_keys, vertical_code_key = (3072, 2048), 4096  # EPSG codes of projected, geographic and vertical systems
    unit_codes = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}  # metre, foot, US survey foot: EPSG
    wkt = records.get(wkt_record, b"").rstrip(b"\0").decode("utf-8", "replace")
    keys = np.frombuffer(records.get(keys_record, b"")[: len(records.get(keys_record, b"")) // 8 * 8], "<u2")
    key = {int(name): int(value) for name, place, _, value in keys.reshape(-1, 4)[1:] if place == 0}
    if _GEOGRAPHIC_WKT.match(wkt) or (not wkt and key.get(model_key) == _GEOGRAPHIC):
        raise InputError(_DEGREES)
    if wkt:
        horizontal, *vertical = _VERTICAL.split(wkt)
        across = _last_unit(horizontal) or 1.0
        return _Units(horizontal_m=across, vertical_m=_last_unit("".join(vertical)) or across)
    code = next((key[name] for name in code_keys if name in key), 0)
    across = unit_codes.get(key.get(unit_key, 0)) or _unit_of_system(code) or 1.0
    upward = unit_codes.get(key.get(vertical_unit_key, 0)) or _unit_of_system(key.get(vertical_code_key, 0))
    return _Units(horizontal_m=across, vertical_m=upward or across)


def _unit_of_system(code: int) -> float | None:
    """Return metres per unit of the system with an EPSG code, None if it or pyproj is missing; refuse angles."""
    try:
        from pyproj import CRS  # type: ignore[import-not-found,unused-ignore]
        from pyproj.exceptions import CRSError  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        return None
    if not 0 < code < _USER_DEFINED:
        return None
    try:
        system = CRS.from_epsg(code)
    except CRSError:
        return None
    if system.is_geographic:
        raise InputError(_DEGREES)
    return float(system.axis_info[0].unit_conversion_factor)


def _last_unit(wkt: str) -> float | None:
    """Return metres per unit of the last length unit in WKT: a system lists the units of its parts before its own."""
    units = [float(metres) for name, metres in _LINEAR_UNIT.findall(wkt) if not _ANGLES.match(name)]
    return units[-1] if units and 1e-6 < units[-1] < 1e6 else None


def check_las_header(stream: SeekableReader, size: int) -> None:
    """Check the header's counts against the file's size; the stream's position does not change.

    Raises:
        FormatError: a count that the file has no room for.
    """
    evlrs_place, header_1_4 = 235, 375
    vlr_bytes, evlr_bytes = 54, 60
    compressed = 0x80  # bit that LAZ sets in the point format
    start = stream.tell()
    head = stream.read(header_1_4)
    if len(head) < _HEADER_BYTES or head[:4] != b"LASF":
        raise FormatError(f"the file is {size} bytes and begins with {head[:4]!r}; it is no LAS file, or truncated")
    header_bytes, points_at, num_vlrs, point_format, row_bytes = struct.unpack_from("<HIIBH", head, 94)
    if not header_bytes <= points_at <= size:
        raise FormatError(f"the points begin at byte {points_at:,} of {size:,}; the LAS header is damaged")
    _require_room("records", num_vlrs, vlr_bytes, points_at - header_bytes)
    if head[25] >= 4 and header_bytes >= header_1_4 and len(head) == header_1_4:
        evlrs_at, num_evlrs = struct.unpack_from("<QI", head, evlrs_place)
        _require_room("extended records", num_evlrs, evlr_bytes, max(size - evlrs_at, 0))
    if point_format & compressed:
        _check_chunks(stream, start, points_at, row_bytes, size)
    stream.seek(start)


def _check_chunks(stream: SeekableReader, start: int, points_at: int, row_bytes: int, size: int) -> None:
    stream.seek(start + points_at)
    stored = stream.read(8)
    table_at = int.from_bytes(stored, "little", signed=True)
    if len(stored) == 8 and table_at == -1:  # written to a pipe: the offset is at the end
        stream.seek(start + size - 8)
        table_at = int.from_bytes(stream.read(8), "little", signed=True)
    if not points_at + len(stored) <= table_at <= size - 8:
        raise FormatError(f"the chunks of the LAZ file are listed at byte {table_at:,} of {size:,}; it is damaged")
    stream.seek(start + table_at + 4)
    num_chunks = int.from_bytes(stream.read(4), "little")
    _require_room("chunks", num_chunks, max(row_bytes, 1), table_at - points_at)  # each begins with a full point


def _require_room(what: str, count: int, each: int, room: int) -> None:
    if count * each > room:
        raise FormatError(
            f"the LAS header tells of {count:,} {what}; in {room:,} bytes there is no room; it is damaged"
        )
