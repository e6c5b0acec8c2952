"""Points of a scan as Gaussians, one per point, scaled by the distance of its neighbours; and PLY without faces."""

from dataclasses import dataclass

import numpy as np
import scipy  # submodules load on first use, so the service starts without them
from jaxtyping import Float32, Float64, Shaped, UInt8

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.origin import shift_to_origin
from dynamictree.formats.ply_table import read_elements, read_header
from dynamictree.formats.seekable import SeekableReader
from dynamictree.formats.splat.activations import harmonic_from_color
from dynamictree.gaussian.cloud import GaussianCloud, check_count
from dynamictree.source import Source
from dynamictree.up_axis import up_rotation

UP_AXIS = "+Z"
"""Surveying instruments stand level and count heights upward."""
_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))


@dataclass(frozen=True, kw_only=True)
class Scan:
    """Points with the values of their file."""

    points: Float64[np.ndarray, "G 3"]
    colors: Shaped[np.ndarray, "G 3"] | None = None  # bytes, 16 bits, or floats in [0, 1]
    dropped: int = 0  # points that are marked as noise
    unit_m: float = 1.0  # metres per unit; 1 if the file states none


def read_points_ply(stream: SeekableReader) -> Scan:
    """Read x, y, z and, if present, a colour of the vertices of a PLY file.

    Raises:
        FormatError: not PLY, no positions, shorter than its header says.
        InputError: too many points.
    """
    header = read_header(stream)
    vertex = header.element("vertex")
    if vertex is None or not vertex.names.issuperset("xyz"):
        raise FormatError("the PLY file has no vertices with x, y and z; it is no point cloud")
    check_count(vertex.count)
    (rows,) = read_elements(stream, header, "vertex")
    points = np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1)
    names = next((names for names in _COLORS if vertex.names.issuperset(names)), None)
    colors = None if names is None else np.stack([rows[name] for name in names], axis=1)
    return Scan(points=points, colors=colors)


def cloud_of_points(scan: Scan, *, up_axis: str = UP_AXIS) -> GaussianCloud:
    """Return a round Gaussian per finite point; points far from the origin are shifted to it.

    Points without colours are shaded, and so are points that are all black, as in LAS files without colours.

    Raises:
        InputError: no point, all points at one place, or positions in degrees.
    """
    opacity = 0.9  # surfaces that were scanned are solid; below 1, neighbours blend
    finite = np.isfinite(scan.points).all(axis=1)
    points = scan.points[finite]
    check_count(len(points))
    extent = np.ptp(points, axis=0)
    if extent.max() == 0:
        raise InputError(f"all {len(points):,} points are at one place; the cloud needs an extent")
    refuse_degrees(points, extent)
    means, offset = shift_to_origin(points)
    if not np.isfinite(means).all():
        raise InputError("positions of the cloud are beyond 3e38, which is no place; remove them")
    points = means.astype(np.float64)
    scales = np.repeat(_spacing(points)[:, None], 3, axis=1)
    if scan.colors is None or not scan.colors.any():
        rgb = shaded_colors(points @ up_rotation(up_axis).T, spacing=2 * float(np.median(scales)))
    else:
        rgb = _byte_color(scan.colors[finite])
    return GaussianCloud(
        means=means,
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (len(points), 1)),
        scales=scales,
        opacity=np.full(len(points), opacity, np.float32),
        sh=harmonic_from_color(rgb / np.float32(255))[:, None],
        source=Source(up_axis="+Z", offset=offset),
        dropped=scan.dropped + int((~finite).sum()),
    )


def refuse_degrees(points: Float64[np.ndarray, "G 3"], extent: Float64[np.ndarray, " 3"]) -> None:
    """Refuse longitude and latitude: x and y in the range of degrees, with an extent far below the height.

    Raises:
        InputError: x and y are degrees.
    """
    degrees = 1e-3  # width over height: 1e-5 for a 10 m tree in degrees, 1e-2 for a pole in metres
    largest = np.abs(points[:, :2]).max(axis=0)
    on_globe = (largest <= 180).all() and largest.min() <= 90 and largest.max() > 1
    if on_globe and 0 < extent[:2].max() < degrees * extent[2]:
        raise InputError(
            f"the points are {extent[0]:.2g} x {extent[1]:.2g} x {extent[2]:.4g} in size: x and y are degrees of "
            "longitude and latitude; project them to metres (UTM), for instance with CloudCompare or "
            "`pdal translate in.las out.las reprojection --filters.reprojection.out_srs=EPSG:32632`"
        )


def find_color_columns(table: Float64[np.ndarray, "G columns"], labels: float) -> list[int] | None:
    """Find three columns after x, y and z that are a colour by their range; None if there are none.

    A colour has integers up to 255 or 65,535, of similar size and beyond `labels`, or values in [0, 1] that are no unit
    vectors. Of four columns the last three are taken, as in PTS, unless the last is an alpha.
    """
    last = table.shape[1] - 3
    first = [column for column in range(3, last + 1) if _is_color(table[:, column : column + 3], labels)]
    if not first:
        return None
    is_pts = table.shape[1] == 7 and first == [3, 4] and not np.isin(table[:, 6], (0, 255, 65_535)).all()
    best = last if is_pts else first[0]
    return [best, best + 1, best + 2]


def _is_color(values: Float64[np.ndarray, "G 3"], labels: float) -> bool:
    alike = 8.0  # largest ratio of the maxima of a colour's channels
    low, high = float(values.min(initial=0)), values.max(axis=0, initial=0)
    if low < 0 or not np.isfinite(high).all() or high.max() > 65_535:
        return False
    if high.max() <= 1:
        return bool(high.min() > 0 and not np.allclose((values**2).sum(axis=1), 1, atol=0.01))
    return bool(labels < high.max() <= alike * high.min() and (values == np.round(values)).all())


def _spacing(points: Float64[np.ndarray, "G 3"]) -> Float32[np.ndarray, " G"]:
    """Return half the root mean square distance to the nearest points, clipped to a few medians [the points' unit]."""
    most_neighbours = 3  # Kerbl et al. 2023, section 5.2: scale by the distance of the three nearest neighbours
    largest_spacing = 4.0  # medians; a stray point stays small
    from scipy.spatial import KDTree  # import takes 0.3 s, which other formats do not need

    num_neighbours = min(most_neighbours, len(points) - 1)
    distances = np.asarray(KDTree(points).query(points, num_neighbours + 1, workers=-1)[0])  # [G, 1 + neighbours]
    spacing = np.sqrt((distances[:, 1:] ** 2).mean(axis=1))
    typical = np.median(spacing[spacing > 0]) if (spacing > 0).any() else np.ptp(points, axis=0).max()
    return np.asarray(0.5 * np.clip(spacing, 0.1 * typical, largest_spacing * typical), np.float32)


def _byte_color(values: Shaped[np.ndarray, "G 3"]) -> UInt8[np.ndarray, "G 3"]:
    """Convert colours of 16 bits or floats in [0, 1] to 8 bits; the largest value decides which they are."""
    largest = float(values.max(initial=0))
    if values.dtype.kind == "f" and largest <= 1:
        values = values * 255.0
    elif largest > 255:
        values = values / 257.0
    return np.asarray(np.clip(np.nan_to_num(values), 0, 255), np.uint8)


def shaded_colors(points: Float64[np.ndarray, "G 3"], *, spacing: float) -> UInt8[np.ndarray, "G 3"]:
    """Shade points in grey, sRGB: bright towards the sun; dark below, behind and inside others.

    +Z is up; `spacing` is the typical distance of neighbours, in the points' unit.
    """
    grey = (150, 162, 128)  # sRGB of a point in full light
    cells = 160  # cells along the cloud's longest side
    most_cells = 6_000_000  # limit of the grid
    least_spacings = 2.0  # smallest cell in spacings, so that the surface is closed
    blur = 1.0  # cells
    sun = np.array([-0.45, -0.55, 0.70])  # direction to the sun, as in the previews
    darkest = 0.42
    deep = 12.0  # occupied cells above that halve the light
    low = points.min(axis=0)
    extent = np.ptp(points, axis=0)
    size = max(float(extent.max()) / cells, least_spacings * spacing)
    size = max(size, float((np.prod(np.maximum(extent, 1e-12)) / most_cells) ** (1 / 3)))
    place = np.floor((points - low) / size).astype(np.int64) + 2  # two empty cells at every side
    shape = tuple(int(side) for side in place.max(axis=0) + 3)
    key = np.ravel_multi_index(tuple(place.T), shape)
    filled = np.bincount(key, minlength=int(np.prod(shape))).reshape(shape) > 0
    density = scipy.ndimage.gaussian_filter(filled.astype(np.float32), blur)
    outward = -np.stack([side.ravel()[key] for side in np.gradient(density)], axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)
    facing = 0.5 + 0.5 * outward @ (sun / np.linalg.norm(sun))
    above = np.cumsum(filled[:, :, ::-1], axis=2, dtype=np.int32)[:, :, ::-1].ravel()[key] - 1
    light = (darkest + (1 - darkest) * facing) * (0.75 + 0.25 * 0.5 ** (above / deep))
    return np.asarray(np.round(light[:, None] * grey).clip(0, 255), np.uint8)
