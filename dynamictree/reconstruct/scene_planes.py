"""Wide planes in a scene of points that all cameras are in front of: floors, tables, walls, cloths."""

import numpy as np

from dynamictree.planes import NEIGHBOURS, Direction, Plane, Points, best_plane, fit_plane, flat_points

_SAMPLED = 8000  # points that planes are sought in
_TRIALS = 400
_MOST_PLANES = 4
THICKNESS = 0.015  # of the cameras' distance
_LEAST_SHARE = 0.04  # of the points
_LEAST_WIDTH = 0.3  # of the cameras' distance, in both directions
_IN_FRONT = 0.95  # of the cameras
_FOCUS_GAP = 0.03  # of the cameras' distance: the plane does not pass through what the cameras look at


def wide_planes(points: Points, cameras: Points, focus: Direction, distance_m: float) -> list[Plane]:
    """Each plane that is wide and flat, and that cameras and what they look at are in front of.

    Points nearer than `THICKNESS` times the distance are on it. Planes are sought by RANSAC among the points' own
    normals, so that a crown's points, which have all normals, are no plane.
    """
    if len(points) <= NEIGHBOURS:
        return []
    rng = np.random.default_rng(0)
    surface = flat_points(points[np.sort(rng.permutation(len(points))[:_SAMPLED])])
    least, thickness = _LEAST_SHARE * len(surface.places), THICKNESS * distance_m
    planes: list[Plane] = []

    def score(plane: Plane) -> float:
        plane = plane.facing(focus - plane.offset * plane.normal)
        on = surface.on(plane, thickness)
        wide = on.sum() > least and _is_wall(surface.places[on], plane.normal, cameras, focus, distance_m)
        return float(on.sum()) if wide else 0.0

    while len(planes) < _MOST_PLANES and len(surface.places):
        best = best_plane(surface.planes(_TRIALS, rng), score, least)
        if best is None:
            break
        plane = fit_plane(surface.places[surface.on(best, thickness)])
        planes.append(plane.facing(focus - plane.offset * plane.normal))
        surface = surface.subset(planes[-1].above(surface.places) >= thickness)
    return planes


def _is_wall(points: Points, normal: Direction, cameras: Points, focus: Direction, distance_m: float) -> bool:
    middle = points.mean(axis=0)
    if (focus - middle) @ normal < _FOCUS_GAP * distance_m:
        return False
    if ((cameras - middle) @ normal > 0).mean() < _IN_FRONT:
        return False
    spread = np.sqrt(np.linalg.eigvalsh(np.cov((points - middle).T)))
    return bool(np.sqrt(12) * spread[1] > _LEAST_WIDTH * distance_m)
