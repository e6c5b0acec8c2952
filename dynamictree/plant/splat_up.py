"""Estimate the up direction of a splat without a stated axis, from the ground or pot that the plant stands on.

A scene reconstructed from photos often has the axes of its first camera, which looked down on the plant, so it is
tilted by 10° to 40°. The ground or table is the widest plane that nearly all points lie above, if their centre is over
it (as in Fu et al. 2008). On a slope the ground is tilted and the tree is not, so the plane counts only if the plant
rises along its normal rather than along the axis assumed before. Without such a plane, the axis of a pot at the bottom
is used.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from dynamictree.planes import Direction, Plane, Points, best_plane, fit_plane, flat_points
from dynamictree.plant.plausibility import one_per_cell
from dynamictree.plant.pot import axis_of_pot, find_pot
from dynamictree.plant.still import height_of
from dynamictree.up_axis import turn_to_z

_LEAST_DEG, _MOST_DEG = 6.0, 50.0
"""Smallest tilt to correct, and the tilt beyond which another axis is up."""
_LEAST_SAMPLED, _SAMPLED, _SAMPLED_OF_POT = 2_000, 12_000, 20_000
_FEWEST = 12  # least number of points on a plane


class _Ground(NamedTuple):
    """Candidate for the ground of a scene."""

    middle: Direction
    plane: Plane  # normal upward
    share: float  # share of the points
    width: float  # smaller width


def up_of_standing(points: Points) -> Direction | None:
    """Return the upward normal of a scene's ground; None if it is level within 6°, missing or doubtful.

    The points are positions of visible Gaussians, +Z up except for a tilt of at most 50°.
    """
    thickness_share = 0.012  # share of the diagonal
    strays, strays_of_pot = 0.01, 0.001  # share of the points at each end of an axis
    rng = np.random.default_rng(0)
    thinned = _thinned(points, strays, _SAMPLED, rng)
    if len(thinned) < _LEAST_SAMPLED:
        return None
    thickness = thickness_share * float(np.linalg.norm(np.ptp(thinned, axis=0)))
    ground = _lowest_plane(thinned, thickness, rng)
    above = thinned[:0] if ground is None else thinned[ground.plane.above(thinned) > 2 * thickness]
    if ground is None or not _carries(ground, above):
        up = _up_of_pot(_thinned(points, strays_of_pot, _SAMPLED_OF_POT, rng), rng)
    else:
        normal = ground.plane.normal
        rise = _rise(above, above @ normal)
        up = normal if rise @ normal > rise[2] else None
    if up is None or not np.cos(np.radians(_MOST_DEG)) < up[2] < np.cos(np.radians(_LEAST_DEG)):
        return None
    return up


def _carries(ground: _Ground, above: Points) -> bool:
    """Whether a plane has enough of the points, and the points above have their centre over it."""
    wide = 0.02  # least share of the points on the ground
    if ground.share < wide or len(above) < _FEWEST:
        return False
    way, normal = above.mean(axis=0) - ground.middle, ground.plane.normal
    return bool(np.linalg.norm(way - way @ normal * normal) < ground.width)


def _rise(points: Points, height: Float64[np.ndarray, " P"]) -> Direction:
    """Return the direction from the foot of a plant to its centre."""
    foot = 0.12  # share of the height above the plane
    low, top = height.min(), np.quantile(height, 0.98)
    rise = points.mean(axis=0) - points[height <= low + foot * (top - low)].mean(axis=0)
    return np.asarray(rise / max(float(np.linalg.norm(rise)), 1e-12))


def _up_of_pot(points: Points, rng: np.random.Generator) -> Direction | None:
    """Search for a pot along several up directions; return its axis, or None."""
    # least cosine between a direction and that from the foot to the centre; number of directions tried
    along_rise, most_tried = 0.94, 8
    directions = _directions()
    along = np.array([_rise(points, points @ up) @ up for up in directions])
    for row in np.argsort(-along)[:most_tried]:
        up, axis = directions[row], None
        if along[row] < along_rise:
            break
        for _ in range(2):  # once upright, the pot is detected better
            turn = turn_to_z(up)
            turned = points @ turn.T
            pot = find_pot(turned, height_of(turned), rng)
            upright = None if pot is None else axis_of_pot(turned, pot)
            if upright is None:
                break
            up = axis = turn.T @ upright
        if axis is not None:
            return np.asarray(axis)
    return None


def _directions() -> list[Direction]:
    """Return unit vectors spread over the directions near +Z."""
    # angle between directions, and the largest tilt; a pot is detected up to 15° from upright
    step_deg, tilted_deg = 15.0, 45.0
    spread: list[Direction] = [np.array([0.0, 0.0, 1.0])]
    for tilt in np.radians(np.arange(step_deg, tilted_deg + 1, step_deg)):
        count = round(2 * np.pi * np.sin(tilt) / np.radians(step_deg))
        turn = np.arange(count) * 2 * np.pi / count
        level = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn)], axis=1)
        spread += list(np.column_stack([level, np.full(count, np.cos(tilt))]))
    return spread


def _lowest_plane(points: Points, thickness: float, rng: np.random.Generator) -> _Ground | None:
    """Find the plane with most points on it and few below."""
    up = np.array([0.0, 0.0, 1.0])
    trials = 500
    below = 0.07  # largest share of the points
    surface = flat_points(points)

    def score(plane: Plane) -> float:
        plane = plane.facing(up)
        steep = plane.normal[2] < np.cos(np.radians(_MOST_DEG))
        if steep or (plane.above(points) < -2 * thickness).mean() > below:
            return 0.0
        return float(surface.on(plane, thickness).sum())

    best = best_plane(surface.planes(trials, rng), score, _FEWEST - 0.5)
    if best is None:
        return None
    on = points[surface.on(best, thickness)]
    sizes = np.linalg.svd(on - on.mean(axis=0), compute_uv=False)
    width = float(np.sqrt(12 / len(on)) * sizes[1])  # side of a square of the same spread
    return _Ground(on.mean(axis=0), fit_plane(on).facing(up), len(on) / len(points), width)


def _thinned(points: Points, strays: float, most: int, rng: np.random.Generator) -> Points:
    """Remove strays and subsample one point per cell; return none if there are too few."""
    cell = 0.008  # share of the diagonal; one point per cell evens out the density
    if len(points) < _LEAST_SAMPLED:
        return points[:0]
    low, high = np.quantile(points, [strays, 1 - strays], axis=0)
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    points = one_per_cell(points, cell * float(np.linalg.norm(high - low)))
    return points[rng.permutation(len(points))[:most]]
