"""Initial Gaussians: at points from structure from motion, stereo, masks and texture, and on a far dome."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8
from scipy.spatial import cKDTree

from dynamictree.reconstruct.depth import DepthMaps
from dynamictree.reconstruct.sky import Foreground
from dynamictree.reconstruct.splat_table import table_of_points
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.reconstruct.visual_hull import hull_points, texture_points

_OPACITY, _DOME_OPACITY = 0.1, 0.95  # Kerbl et al.'s 0.1 lets the optimisation remove errors of stereo
_DOME_POINTS, _DOME_DISTANCE = 3000, 12.0  # number, and distance [radius of the region]
_LEAST_SOLID, _LEAST_SKY = 0.8, 0.02  # share of the photos that see a point of the dome
_COVERED = 230  # least cover of a pixel that counts, of 255
_GOLDEN = np.pi * (3 - np.sqrt(5))
Cover = UInt8[np.ndarray, "H W"]


def initial_table(
    model: SparseModel,
    depths: DepthMaps | None,
    *,
    number: int,
    sh_degree: int,
    rng: np.random.Generator,
    sky: Sequence[Foreground] | None = None,
) -> Float32[np.ndarray, "G P"]:
    """Create about `number` isotropic Gaussians, sized by their spacing; without masks also some on a far dome.

    The model is in the upright frame, in which the region's radius is 1; it has the views of the depth maps.
    """
    crown_share = 0.4  # share of the other points, which are missing in thin crowns
    covers = None if sky is None else [view.alpha for view in sky]
    points, colors = model.points, model.colors / np.float32(255)
    if depths is not None:
        dense, dense_colors = points_of_depths(model, depths, sky)
        points, colors = np.concatenate([points, dense]), np.concatenate([colors, dense_colors])
    hull, hull_colors = hull_points(model.views, number, rng)
    points, colors = np.concatenate([points, hull]), np.concatenate([colors, hull_colors])
    rows = subsample(points, number, rng)
    points, colors = points[rows].astype(np.float32), colors[rows].astype(np.float32)
    whole = all(view.alpha is None for view in model.views)
    if whole:
        crown, crown_colors = texture_points(model.views, round(crown_share * number), rng, covers)
        points = np.concatenate([points, crown.astype(np.float32)])
        colors = np.concatenate([colors, crown_colors])
    table = table_of_points(points, colors, point_spacing(points), opacity=_OPACITY, sh_degree=sh_degree)
    if not whole:
        return table
    far, far_colors, share = dome_points(model.views, covers)
    solid = share >= _LEAST_SOLID
    return np.concatenate([table, _dome_table(far[solid], far_colors[solid], 1.0, _DOME_POINTS, sh_degree)])


def sky_table(views: Sequence[View], sky: Sequence[Foreground], sh_degree: int) -> Float32[np.ndarray, "S P"]:
    """Create opaque Gaussians behind the scene where photos show sky, and slightly beyond; they are not optimised."""
    sky_distance, beside_sky = 100.0, 0.15  # [region's radius], and extension beyond the seen sky [that distance]
    sky_points, sky_width = 12_000, 1.5  # number on a whole sphere, and factor of the dome's widths
    points, colors, share = dome_points(views, [255 - view.alpha for view in sky], sky_points, sky_distance)
    clear = np.flatnonzero(share >= _LEAST_SKY)
    away, nearest = (np.asarray(part) for part in cKDTree(points[clear]).query(points))
    beside = away < beside_sky * sky_distance
    width = sky_width * sky_distance / _DOME_DISTANCE
    return _dome_table(points[beside], colors[clear[nearest[beside]]], width, sky_points, sh_degree)


def _dome_table(
    points: Float32[np.ndarray, "D 3"], colors: Float32[np.ndarray, "D 3"], width: float, number: int, sh_degree: int
) -> Float32[np.ndarray, "D P"]:
    """Create Gaussians of half the spacing of `number` points on a whole sphere, times `width`."""
    size = np.full(len(points), width * _DOME_DISTANCE * np.sqrt(4 * np.pi / number) / 2, np.float32)
    return table_of_points(points, colors, size, opacity=_DOME_OPACITY, sh_degree=sh_degree)


def points_of_depths(
    model: SparseModel, depths: DepthMaps, sky: Sequence[Foreground] | None = None
) -> tuple[Float64[np.ndarray, "P 3"], Float32[np.ndarray, "P 3"]]:
    """Back-project every pixel that has a depth, with the photo's colour without sky."""
    points, colors = [], []
    images = [view.image for view in model.views] if sky is None else [view.image for view in sky]
    for image, stereo, depth in zip(images, depths.views, depths.depths, strict=True):
        row, column = np.nonzero(depth > 0)
        points.append(stereo.places(np.stack([column + 0.5, row + 0.5], axis=1), depth[row, column]))
        height, width = image.shape[:2]
        at = row * height // depth.shape[0], column * width // depth.shape[1]
        colors.append(image[at] / np.float32(255))
    return np.concatenate(points), np.concatenate(colors)


def subsample(points: Float64[np.ndarray, "P 3"], number: int, rng: np.random.Generator) -> Int64[np.ndarray, " K"]:
    """Subsample about `number` points evenly in space, a random one per cell of a grid; return their rows."""
    if len(points) <= number:
        return np.arange(len(points))
    order = rng.permutation(len(points))
    low, high = 1e-4, 1.0  # bounds of a cell's side [spread of the points]
    spread = float(np.percentile(np.abs(points - np.median(points, axis=0)), 95))
    for _ in range(16):
        side = np.sqrt(low * high)
        cells = np.floor(points[order] / (side * spread)).astype(np.int64)
        chosen = np.unique(cells, axis=0, return_index=True)[1]
        if len(chosen) > number:
            low = side
        else:
            high = side
    return np.sort(order[chosen])


def point_spacing(points: Float32[np.ndarray, "G 3"]) -> Float32[np.ndarray, " G"]:
    """Compute half the mean distance to the three nearest points, with an upper limit; after Kerbl et al."""
    widest_share = 0.1  # [region's radius], limit for isolated points
    distance = np.asarray(cKDTree(points).query(points, k=4)[0])[:, 1:].mean(axis=1)
    return np.asarray(np.clip(distance / 2, 1e-5, widest_share), np.float32)


def dome_points(
    views: Sequence[View],
    covers: Sequence[Cover] | None = None,
    number: int = _DOME_POINTS,
    distance: float = _DOME_DISTANCE,
) -> tuple[Float32[np.ndarray, "D 3"], Float32[np.ndarray, "D 3"], Float64[np.ndarray, " D"]]:
    """Return points on a far sphere, their mean colour, and the share of the photos seeing them that count.

    With `covers`, a photo counts only where it is covered.
    """
    place = np.arange(number) + 0.5
    z = 1 - 2 * place / number
    side = np.sqrt(1 - z * z)
    points = distance * np.stack([side * np.cos(_GOLDEN * place), side * np.sin(_GOLDEN * place), z], axis=1)
    total, weight, seen = np.zeros((number, 3)), np.zeros(number), np.zeros(number)
    for row, view in enumerate(views):
        at, inside = view.pixels_of(points)
        counts = inside if covers is None else inside & (covers[row][at] > _COVERED)
        total += counts[:, None] * view.image[at] / 255
        weight += counts
        seen += inside
    colors = total / np.maximum(weight, 1e-9)[:, None]
    return points.astype(np.float32), colors.astype(np.float32), weight / np.maximum(seen, 1)
