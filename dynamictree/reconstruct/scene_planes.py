"""Wide planes in a scene of points that all cameras are in front of: floors, tables, walls, cloths."""

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

Points = Float64[np.ndarray, "_ 3"]

_SAMPLED = 8000  # points that planes are sought in
_TRIALS = 400
_MOST_PLANES = 4
_NEIGHBOURS = 12  # whose spread tells the normal
_FLAT = 0.25  # standard deviation across over that along a surface
_ALONG = 0.85  # cosine between a plane's normal and a point's
_THICKNESS = 0.015  # of the cameras' distance
_LEAST_SHARE = 0.04  # of the points
_LEAST_WIDTH = 0.3  # of the cameras' distance, in both directions
_IN_FRONT = 0.95  # of the cameras
_FOCUS_GAP = 0.03  # of the cameras' distance: the plane does not pass through what the cameras look at


def behind_planes(
    points: Points, cameras: Points, focus: Float64[np.ndarray, "3"], distance_m: float
) -> Bool[np.ndarray, " P"]:
    """Points on or behind a plane that is wide and flat, and that cameras and what they look at are in front of.

    Planes are sought by RANSAC among the points' own normals, so that a crown's points, which have all normals, are
    no plane.
    """
    rng = np.random.default_rng(0)
    rest = np.sort(rng.permutation(len(points))[:_SAMPLED])
    thickness = _THICKNESS * distance_m
    behind = np.zeros(len(points), np.bool_)
    if len(rest) <= _NEIGHBOURS:
        return behind
    normals, flat = _normals(points[rest])
    least = _LEAST_SHARE * len(rest)
    for _ in range(_MOST_PLANES):
        left = ~behind[rest]
        plane = _best_plane(points[rest[left]], normals[left], flat[left], cameras, focus, thickness, least, rng)
        if plane is None:
            break
        behind |= points @ plane[:3] - plane[3] < thickness
    return behind


def _normals(points: Points) -> tuple[Points, Bool[np.ndarray, " P"]]:
    near = np.asarray(cKDTree(points).query(points, k=_NEIGHBOURS)[1])
    around = points[near] - points[near].mean(axis=1, keepdims=True)  # [P, K, 3]
    spread, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", around, around))
    return axes[:, :, 0], spread[:, 0] < _FLAT**2 * spread[:, 1]


def _best_plane(
    points: Points,
    normals: Points,
    flat: Bool[np.ndarray, " P"],
    cameras: Points,
    focus: Float64[np.ndarray, "3"],
    thickness: float,
    least: float,
    rng: np.random.Generator,
) -> Float64[np.ndarray, "4"] | None:
    """Normal towards the cameras and offset of the plane with most flat points along it; None if none is enough."""
    candidates = np.flatnonzero(flat)
    best, best_count = None, least
    for row in rng.permutation(candidates)[:_TRIALS]:
        normal = normals[row] * np.sign((focus - points[row]) @ normals[row])
        on = _on(points, normals, flat, normal, float(normal @ points[row]), thickness)
        if on.sum() > best_count and _is_wall(points[on], normal, cameras, focus, thickness):
            best, best_count = on, int(on.sum())
    if best is None:
        return None
    middle = points[best].mean(axis=0)
    normal = np.linalg.svd(points[best] - middle, full_matrices=False)[2][2]
    normal = normal * np.sign((focus - middle) @ normal)
    return np.append(normal, normal @ middle)


def _on(
    points: Points,
    normals: Points,
    flat: Bool[np.ndarray, " P"],
    normal: Float64[np.ndarray, "3"],
    offset: float,
    thickness: float,
) -> Bool[np.ndarray, " P"]:
    chosen: Bool[np.ndarray, " P"] = flat & (np.abs(points @ normal - offset) < thickness)
    chosen &= np.abs(normals @ normal) > _ALONG
    return chosen


def _is_wall(
    points: Points,
    normal: Float64[np.ndarray, "3"],
    cameras: Points,
    focus: Float64[np.ndarray, "3"],
    thickness: float,
) -> bool:
    middle = points.mean(axis=0)
    if (focus - middle) @ normal < thickness * _FOCUS_GAP / _THICKNESS:
        return False
    if ((cameras - middle) @ normal > 0).mean() < _IN_FRONT:
        return False
    spread = np.sqrt(np.linalg.eigvalsh(np.cov((points - middle).T)))
    return bool(np.sqrt(12) * spread[1] > _LEAST_WIDTH * thickness / _THICKNESS)
