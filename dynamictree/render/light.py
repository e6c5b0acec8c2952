"""Compute the visibility of sun and sky at a point.

The sun casts shadows by a depth map. The sky is dimmed as by leaves in a crown (Beer-Lambert law): the surface in a
coarse grid is an optical density, integrated along a few directions. Both are soft and deterministic.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32
from scipy.ndimage import shift

from dynamictree.parallel import compiled
from dynamictree.render.appearance import Appearance
from dynamictree.render.raster import rasterise, screen_triangles

_SUN_MAP = 768  # texels per side
_PENUMBRA = 2.6  # [texels], radius around a point within which the shadow map is sampled
_PHASES = 16
MAX_SHADOW_SAMPLES = 8
_SKY_CELLS = 44  # number along the largest extent


def _sample_patterns() -> Float32[np.ndarray, "P L 2"]:
    """Create patterns of offsets on a disc, each rotated differently; the first half of each covers the disc too."""
    number = np.arange(_PHASES * MAX_SHADOW_SAMPLES).reshape(MAX_SHADOW_SAMPLES, _PHASES).T  # [P, L]
    radius = _PENUMBRA * np.sqrt((number + 0.5) / number.size)
    turn = number * np.pi * (3 - np.sqrt(5))  # golden angle
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=2).astype(np.float32)


class SunMap(NamedTuple):
    """Shadow map: depth of the first surface seen from the sun."""

    axes: Float64[np.ndarray, "3 3"]  # rows: right, up and towards the sun
    low: Float64[np.ndarray, "2"]  # corner of the map along the first two axes [m]
    texels_per_m: float
    nearness: Float32[np.ndarray, "S S"]  # largest coordinate along the third axis [m]
    looks: Float32[np.ndarray, "P L 2"]  # offsets of samples around a point [texels]


class SkyVolume(NamedTuple):
    """Share of the sky visible from the cells of a grid."""

    low: Float64[np.ndarray, "3"]  # centre of the first cell [m]
    cell_m: float
    share: Float32[np.ndarray, "X Y Z"]


# placeholders for pictures without shadows, never sampled
BARE_SUN = SunMap(np.eye(3), np.zeros(2), 1.0, np.zeros((1, 1), np.float32), _sample_patterns())
OPEN_SKY = SkyVolume(np.zeros(3), 1.0, np.ones((1, 1, 1), np.float32))


def sun_map(
    vertices: Float32[np.ndarray, "N 3"],
    faces: Int32[np.ndarray, "F 3"],
    appearance: Appearance,
    sun: Float64[np.ndarray, "3"],
) -> SunMap:
    """Render the shadow map of a mesh; `sun` is a unit vector."""
    right = np.cross((0.0, 1.0, 0.0) if abs(sun[2]) > 0.99 else (0.0, 0.0, 1.0), sun)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(sun, right), sun])  # [3, 3]
    seen = vertices @ axes.T  # [N, 3]
    low = seen[:, :2].min(axis=0)
    across = max(
        float(np.ptp(seen[:, :2], axis=0).max()), 1e-6 * float(np.ptp(seen[:, 2]))
    )  # positive even for a stick that points to the sun
    texels_per_m = (_SUN_MAP - 2) / across
    homogeneous = np.concatenate([(seen[:, :2] - low) * texels_per_m + 1, np.ones((len(seen), 1))], axis=1)
    triangles = screen_triangles(homogeneous, faces, appearance, width=_SUN_MAP, height=_SUN_MAP)
    nearness = np.ascontiguousarray(seen[:, 2].astype(np.float32))
    visible = rasterise(triangles, faces, nearness, appearance, width=_SUN_MAP, height=_SUN_MAP)
    return SunMap(axes, low - 1 / texels_per_m, texels_per_m, visible.nearness, _sample_patterns())


def sky_volume(vertices: Float32[np.ndarray, "N 3"], faces: Int32[np.ndarray, "F 3"]) -> SkyVolume:
    """Integrate the optical depth of the mesh, as a cloud of small leaves, along a few directions."""
    sky_border = 0.35  # share of the largest extent; width of the contact shadow on the ground
    low, high = vertices.min(axis=0).astype(np.float64), vertices.max(axis=0).astype(np.float64)
    extent = float((high - low).max())
    cell_m = extent / _SKY_CELLS
    border = np.array([sky_border * extent, sky_border * extent, cell_m])
    low, high = low - border, high + border
    depth = np.zeros(np.ceil((high - low) / cell_m).astype(int) + 1, np.float32)
    _splat_area(vertices, faces, low, cell_m, depth)
    share = np.zeros_like(depth)
    for direction, weight in zip(*_sky_directions(), strict=True):
        step = 1 / direction[2]
        layer = np.ones(depth.shape[:2], np.float32)
        share[:, :, -1] += weight
        for z in range(depth.shape[2] - 2, -1, -1):
            above = layer * np.exp(-depth[:, :, z + 1] * step)
            layer = shift(above, -step * direction[:2], order=1, mode="grid-constant", cval=1.0)
            share[:, :, z] += weight * layer
    return SkyVolume(low=low, cell_m=cell_m, share=share)


def _sky_directions() -> tuple[Float64[np.ndarray, "D 3"], Float32[np.ndarray, " D"]]:
    sky_directions = ((90.0, 1), (55.0, 5), (25.0, 5))  # elevation in degrees, number of azimuths
    rows = []
    for elevation_deg, number in sky_directions:
        elevation = np.radians(elevation_deg)
        for turn in 2 * np.pi * (np.arange(number) + elevation_deg / 90) / number:
            rows.append([np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation)])
    directions = np.array(rows)
    weights = directions[:, 2]  # cosine law of a level surface
    return directions, (weights / weights.sum()).astype(np.float32)


@compiled
@no_type_check
def _splat_area(vertices, faces, low, cell_m, depth):
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        area = 0.5 * np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)
        longest = np.sqrt(max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz))
        cuts = min(max(int(np.ceil(longest / cell_m)), 1), 2 * _SKY_CELLS)
        # randomly oriented leaves project half of their area; per cell face this is an optical depth
        amount = np.float32(0.5 * area / (cell_m * cell_m) / (cuts * cuts))
        for i in range(cuts):
            for j in range(cuts):
                # centroids of the cuts² equal triangles: upright for i + j + 1 <= cuts, else mirrored
                s, t = (i + 1 / 3) / cuts, (j + 1 / 3) / cuts
                if i + j >= cuts:
                    s, t = 1 - (i + 2 / 3) / cuts, 1 - (j + 2 / 3) / cuts
                x = int((a[0] + s * ux + t * vx - low[0]) / cell_m + 0.5)
                y = int((a[1] + s * uy + t * vy - low[1]) / cell_m + 0.5)
                z = int((a[2] + s * uz + t * vz - low[2]) / cell_m + 0.5)
                depth[x, y, z] += amount


@compiled
@no_type_check
def sun_share(sun, x, y, z, looks):
    """Compute the share of the sun at a point [m], by samples of the shadow map in one of the patterns."""
    phase, num_looks = looks
    axes = sun.axes
    u = ((axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z) - sun.low[0]) * sun.texels_per_m
    v = ((axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z) - sun.low[1]) * sun.texels_per_m
    near = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z + 1.5 / sun.texels_per_m
    size, reach = len(sun.nearness), _PENUMBRA + 1
    if u < -reach or v < -reach or u > size + reach or v > size + reach:
        return 1.0
    lit = num_looks
    for look in range(num_looks):
        around = sun.looks[phase % _PHASES, look]
        column, row = int(u + around[0] + 4) - 4, int(v + around[1] + 4) - 4
        if 0 <= column < size and 0 <= row < size and sun.nearness[row, column] > near:
            lit -= 1
    return lit / num_looks


@compiled
@no_type_check
def sky_share(sky, x, y, z):
    """Interpolate the share of the sky at a point [m] trilinearly; 1 outside the grid."""
    size_x, size_y, size_z = sky.share.shape
    gx, gy, gz = (x - sky.low[0]) / sky.cell_m, (y - sky.low[1]) / sky.cell_m, (z - sky.low[2]) / sky.cell_m
    if not (0 <= gx < size_x - 1 and 0 <= gy < size_y - 1 and gz < size_z - 1):
        return 1.0
    gz = max(gz, 0.0)
    i, j, k = int(gx), int(gy), int(gz)
    fx, fy, fz = gx - i, gy - j, gz - k
    total = 0.0
    for corner in range(8):
        dx, dy, dz = corner % 2, corner // 2 % 2, corner // 4
        weight = (fx if dx else 1 - fx) * (fy if dy else 1 - fy) * (fz if dz else 1 - fz)
        total += weight * sky.share[i + dx, j + dy, k + dz]
    return total
