"""Which way is up in a splat whose file does not say: what the plant stands on is level.

A scene that is reconstructed from photos often has the axes of its first camera, which looked down on the plant, so
that all stands 10° to 40° aslant. The widest plane that nearly all lies above is what it stands on: ground, table, or
the bottom of its pot (as in Fu et al. 2008). On a slope the ground is aslant and the tree is not: the plane counts only
if the plant rises along its normal rather than along the axis taken before. A small plane, such as the bottom of a pot,
counts only if the plant looks clearly more upright on it.
"""

import numpy as np
from jaxtyping import Float64

from dynamictree.formats.axes import turn_to_z
from dynamictree.formats.upright import standing_score
from dynamictree.gaussian.flat_points import FlatPoints, flat_points

Points = Float64[np.ndarray, "_ 3"]

_LEAST_DEG, _MOST_DEG = 6.0, 50.0
"""Tilt that is worth a turn; and beyond which another axis is up."""
_STRAYS = 0.01  # of the points at each end of an axis
_CELL = 0.008  # of the scene's diagonal: one point each counts, however dense they lie
_LEAST_SAMPLED, _SAMPLED = 2_000, 12_000
_TRIALS = 500
_THICKNESS = 0.012  # of the diagonal
_BELOW = 0.07  # of the points, at most
_FEWEST = 12  # points on a plane
_NARROWEST = 0.03  # of the diagonal
_FOOT = 0.12  # of the height of what stands on the plane
_WIDE, _GAIN = 0.02, 0.4
"""Share of the points on a plane that is ground; and by how much the score must rise for a smaller one."""


def up_of_standing(points: Points) -> Float64[np.ndarray, " 3"] | None:
    """The upward normal of what a scene stands on; None where that is level within 6°, not found or in doubt.

    Args:
        points: of visible Gaussians, +Z up but for a tilt of 50° at most.
    """
    if len(points) < _LEAST_SAMPLED:
        return None
    low, high = np.quantile(points, [_STRAYS, 1 - _STRAYS], axis=0)
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    diagonal = float(np.linalg.norm(high - low))
    rng = np.random.default_rng(0)
    thinned = _one_per_cell(points, _CELL * diagonal)
    thinned = thinned[rng.permutation(len(thinned))[:_SAMPLED]]
    if len(thinned) < _LEAST_SAMPLED:
        return None
    plane = _lowest_plane(thinned, flat_points(thinned), _THICKNESS * diagonal, rng)
    if plane is None:
        return None
    middle, normal, width, share = plane
    if not np.cos(np.radians(_MOST_DEG)) < normal[2] < np.cos(np.radians(_LEAST_DEG)) or width < _NARROWEST * diagonal:
        return None
    height = (thinned - middle) @ normal
    above = height > 2 * _THICKNESS * diagonal
    if above.sum() < _FEWEST:
        return None
    stands = _rises_along if share >= _WIDE else _looks_upright
    return normal if stands(thinned[above], normal, height[above]) else None


def _rises_along(points: Points, normal: Float64[np.ndarray, " 3"], height: Float64[np.ndarray, " P"]) -> bool:
    """Whether the way from the foot of a plant to its middle is along a normal rather than along +Z."""
    low, top = height.min(), np.quantile(height, 0.98)
    foot = points[height <= low + _FOOT * (top - low)]
    rise = points.mean(axis=0) - foot.mean(axis=0)
    return bool(rise @ normal > rise[2])


def _looks_upright(points: Points, normal: Float64[np.ndarray, " 3"], height: Float64[np.ndarray, " P"]) -> bool:
    """Whether a plant that is turned until a normal is up looks clearly more like one that stands."""
    return standing_score(points @ turn_to_z(normal).T) - standing_score(points) >= _GAIN


def _lowest_plane(
    points: Points, surface: FlatPoints, thickness: float, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"], float, float] | None:
    """Middle, upward normal, lesser width and share of the points of the plane that holds most, by RANSAC."""
    steep = np.abs(surface.normals[:, 2]) < np.cos(np.radians(_MOST_DEG))
    best, best_count = None, _FEWEST - 1
    for row in rng.permutation(np.flatnonzero(surface.flat & ~steep))[:_TRIALS]:
        normal = surface.normals[row] * np.sign(surface.normals[row, 2])
        offset = float(normal @ points[row])
        if (points @ normal < offset - 2 * thickness).mean() > _BELOW:
            continue
        on = surface.on_plane(points, normal, offset, thickness)
        if on.sum() > best_count:
            best, best_count = on, int(on.sum())
    if best is None:
        return None
    middle = points[best].mean(axis=0)
    _, sizes, axes = np.linalg.svd(points[best] - middle, full_matrices=False)
    width = float(np.sqrt(12 / best_count) * sizes[1])  # of a square of the same spread
    return middle, axes[2] * np.sign(axes[2, 2]), width, best_count / len(points)


def _one_per_cell(points: Points, cell: float) -> Points:
    if cell <= 0:
        return points
    _, first = np.unique(np.floor((points - points.min(axis=0)) / cell).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]
