"""Wide planes in a scene of points that all cameras are in front of: floors, tables, walls, cloths."""

import numpy as np
from jaxtyping import Float64

from dynamictree.flat_points import NEIGHBOURS, FlatPoints, flat_points

Points = Float64[np.ndarray, "_ 3"]

_SAMPLED = 8000  # points that planes are sought in
_TRIALS = 400
_MOST_PLANES = 4
THICKNESS = 0.015  # of the cameras' distance
_LEAST_SHARE = 0.04  # of the points
_LEAST_WIDTH = 0.3  # of the cameras' distance, in both directions
_IN_FRONT = 0.95  # of the cameras
_FOCUS_GAP = 0.03  # of the cameras' distance: the plane does not pass through what the cameras look at


def wide_planes(
    points: Points, cameras: Points, focus: Float64[np.ndarray, "3"], distance_m: float
) -> Float64[np.ndarray, "L 4"]:
    """Normal and offset of each plane that is wide and flat, and that cameras and what they look at are in front of.

    Points nearer than `THICKNESS` times the distance are on it. Planes are sought by RANSAC among the points' own
    normals, so that a crown's points, which have all normals, are no plane.
    """
    rng = np.random.default_rng(0)
    rest = np.sort(rng.permutation(len(points))[:_SAMPLED])
    thickness = THICKNESS * distance_m
    planes = []
    behind = np.zeros(len(points), np.bool_)
    if len(rest) <= NEIGHBOURS:
        return np.zeros((0, 4))
    surface = flat_points(points[rest])
    least = _LEAST_SHARE * len(rest)
    for _ in range(_MOST_PLANES):
        left = ~behind[rest]
        plane = _best_plane(points[rest[left]], surface.subset(left), cameras, focus, thickness, least, rng)
        if plane is None:
            break
        planes.append(plane)
        behind |= points @ plane[:3] - plane[3] < thickness
    return np.array(planes).reshape(-1, 4)


def _best_plane(
    points: Points,
    surface: FlatPoints,
    cameras: Points,
    focus: Float64[np.ndarray, "3"],
    thickness: float,
    least: float,
    rng: np.random.Generator,
) -> Float64[np.ndarray, "4"] | None:
    """Normal towards the cameras and offset of the plane with most flat points along it; None if none is enough."""
    candidates = np.flatnonzero(surface.flat)
    best, best_count = None, least
    for row in rng.permutation(candidates)[:_TRIALS]:
        normal = surface.normals[row] * np.sign((focus - points[row]) @ surface.normals[row])
        on = surface.on_plane(points, normal, float(normal @ points[row]), thickness)
        if on.sum() > best_count and _is_wall(points[on], normal, cameras, focus, thickness):
            best, best_count = on, int(on.sum())
    if best is None:
        return None
    middle = points[best].mean(axis=0)
    normal = np.linalg.svd(points[best] - middle, full_matrices=False)[2][2]
    normal = normal * np.sign((focus - middle) @ normal)
    return np.append(normal, normal @ middle)


def _is_wall(
    points: Points,
    normal: Float64[np.ndarray, "3"],
    cameras: Points,
    focus: Float64[np.ndarray, "3"],
    thickness: float,
) -> bool:
    middle = points.mean(axis=0)
    if (focus - middle) @ normal < thickness * _FOCUS_GAP / THICKNESS:
        return False
    if ((cameras - middle) @ normal > 0).mean() < _IN_FRONT:
        return False
    spread = np.sqrt(np.linalg.eigvalsh(np.cov((points - middle).T)))
    return bool(np.sqrt(12) * spread[1] > _LEAST_WIDTH * thickness / THICKNESS)
