"""Initial Gaussians: at points of structure from motion, stereo, masks and textured parts, and on a far dome."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64, Int64
from scipy.spatial import cKDTree

from dynamictree.reconstruct.depth import DepthMaps
from dynamictree.reconstruct.splat_table import table_of_points
from dynamictree.reconstruct.texture_hull import texture_points
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.reconstruct.visual_hull import hull_points

_OPACITY, _DOME_OPACITY = 0.1, 0.95  # Kerbl et al. begin with 0.1; stereo's errors then fade before they settle
_CROWN_SHARE = 0.4  # of the other points: in a thin crown there are none of them
_WIDEST_SHARE = 0.1  # of the cameras' distance, for a point far from all others
_DOME_POINTS, _DOME_DISTANCE = 3000, 12.0  # of the radius of the region that the pictures hold
_GOLDEN = np.pi * (3 - np.sqrt(5))


def first_table(
    model: SparseModel, depths: DepthMaps | None, *, number: int, sh_degree: int, dome: bool, rng: np.random.Generator
) -> Float32[np.ndarray, "G P"]:
    """Up to about `number` round Gaussians as wide as their neighbours are near; and with `dome`, some far away.

    The model is in the stage's frame, in which the region has the radius 1; its views are those of the depth maps.
    """
    points, colors = model.points, model.colors / np.float32(255)
    if depths is not None:
        dense, dense_colors = points_of_depths(model, depths)
        points, colors = np.concatenate([points, dense]), np.concatenate([colors, dense_colors])
    hull, hull_colors = hull_points(model.views, number, rng)
    points, colors = np.concatenate([points, hull]), np.concatenate([colors, hull_colors])
    rows = thinned(points, number, rng)
    points, colors = points[rows].astype(np.float32), colors[rows].astype(np.float32)
    if all(view.alpha is None for view in model.views):
        crown, crown_colors = texture_points(model.views, round(_CROWN_SHARE * number), rng)
        points = np.concatenate([points, crown.astype(np.float32)])
        colors = np.concatenate([colors, crown_colors])
    table = table_of_points(points, colors, spacing(points), opacity=_OPACITY, sh_degree=sh_degree)
    if not dome:
        return table
    far, far_colors = dome_points(model.views)
    size = np.full(len(far), _DOME_DISTANCE * np.sqrt(4 * np.pi / _DOME_POINTS) / 2, np.float32)
    behind = table_of_points(far, far_colors, size, opacity=_DOME_OPACITY, sh_degree=sh_degree)
    return np.concatenate([table, behind])


def points_of_depths(
    model: SparseModel, depths: DepthMaps
) -> tuple[Float64[np.ndarray, "P 3"], Float32[np.ndarray, "P 3"]]:
    """Back-project every pixel that has a depth, with the photo's colour."""
    points, colors = [], []
    for view, stereo, depth in zip(model.views, depths.views, depths.depths, strict=True):
        row, column = np.nonzero(depth > 0)
        pixels = np.stack([column + 0.5, row + 0.5, np.ones(len(row))], axis=1)
        points.append(stereo.position + depth[row, column, None] * (pixels @ stereo.to_ray.T))
        height, width = view.image.shape[:2]
        at = (row * height // depth.shape[0], column * width // depth.shape[1])
        colors.append(view.image[at] / np.float32(255))
    return np.concatenate(points), np.concatenate(colors)


def thinned(points: Float64[np.ndarray, "P 3"], number: int, rng: np.random.Generator) -> Int64[np.ndarray, " K"]:
    """Rows of about `number` points, evenly in space: a random one per cell of a grid."""
    if len(points) <= number:
        return np.arange(len(points))
    order = rng.permutation(len(points))
    low, high = 1e-4, 1.0  # of the spread, the cell's side
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


def spacing(points: Float32[np.ndarray, "G 3"]) -> Float32[np.ndarray, " G"]:
    """Mean distance to the nearest three others, as Kerbl et al. begin; of lonely ones not more than the widest."""
    distance = np.asarray(cKDTree(points).query(points, k=4)[0])[:, 1:].mean(axis=1)
    limited: Float32[np.ndarray, " G"] = np.clip(distance / 2, 1e-5, _WIDEST_SHARE).astype(np.float32)
    return limited


def dome_points(views: Sequence[View]) -> tuple[Float32[np.ndarray, "D 3"], Float32[np.ndarray, "D 3"]]:
    """Points on a far sphere that a photo shows, with the mean colour of those photos."""
    place = np.arange(_DOME_POINTS) + 0.5
    z = 1 - 2 * place / _DOME_POINTS
    side = np.sqrt(1 - z * z)
    points = _DOME_DISTANCE * np.stack([side * np.cos(_GOLDEN * place), side * np.sin(_GOLDEN * place), z], axis=1)
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    for view in views:
        height, width = view.image.shape[:2]
        x, y, depth = view.camera.project(points, width, height).T
        inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        total[inside] += view.image[y[inside].astype(int), x[inside].astype(int)] / 255
        weight += inside
    seen = weight > 0
    return points[seen].astype(np.float32), (total[seen] / weight[seen, None]).astype(np.float32)
