"""Automatic proposal of the plant in a scene of Gaussians: near, not ground, and central in the photos."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.planes import NEIGHBOURS, Direction, Plane, Points, best_plane, fit_plane, flat_points
from dynamictree.plant.still import touching_groups
from dynamictree.plant.still_cloud import find_still_gaussians
from dynamictree.reconstruct.photo_cameras import PhotoCamera, evenly_chosen, focus_of

_NEAR_DISTANCE = 0.85  # share of the cameras' distance from their focus; Gaussians farther away are background
_WHOLE = 0.7  # share of an object's Gaussians that must lie in most photos
_CENTRAL = 0.5  # share of half the picture; objects farther from its middle count little
_IN_GROUND, _BELOW = 0.2, 0.7  # share of the ground's thickness: feet are higher, and horizontally nearer to the plant
THICKNESS = 0.015  # share of the cameras' distance, within which points lie on a plane


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """Labels of each Gaussian by the cameras and the ground."""

    near: Bool[np.ndarray, " G"]  # candidates for the plant
    background: Bool[np.ndarray, " G"]  # near, but not the plant: ground, pot, partly outside the photos
    central: Bool[np.ndarray, " G"]  # probably the plant: the largest object in the middle of the photos


def propose_plant(cloud: GaussianCloud, views: list[PhotoCamera]) -> Proposal:
    """Label Gaussians as near or far, background (ground, pots and other objects) and central."""
    level = 0.9  # least z of the ground's normal
    most_views = 40
    cell = 0.02  # share of the cameras' distance; Gaussians closer together are one object
    faint = 0.05  # opacity of nearly invisible Gaussians
    wide = 0.15  # share of the cameras' distance; wider Gaussians are background
    in_picture = 0.5  # share of the photos that must contain the plant; floors and walls extend beyond them
    chosen = evenly_chosen(views, most_views)
    focus, distance = focus_of(chosen)
    means = cloud.means.astype(np.float64)
    away = np.linalg.norm(means - focus, axis=1)
    near = (away < _NEAR_DISTANCE * distance) & (cloud.scales.max(axis=1) < wide * distance) & (cloud.opacity > faint)
    background = np.zeros(cloud.num_gaussians, np.bool_)
    if not near.any():
        return Proposal(near=near, background=background, central=background)
    coverage, middle = _places_in_pictures(means, chosen)
    rows = np.flatnonzero(near)
    cameras = np.array([view.camera.position_m for view in chosen])
    planes = wide_planes(means[rows], cameras, focus, distance)
    heights = [plane.above(means) for plane in planes]
    for height in heights:
        background[rows] |= height[rows] < THICKNESS * distance
    rows = np.flatnonzero(near & ~background & (coverage >= in_picture))
    if len(rows):
        background[rows] = find_still_gaussians(cloud.subset(rows))[1] > 0
    rows = np.flatnonzero(near & ~background)
    inside = _inside_groups(means[rows], coverage[rows] >= in_picture, middle[rows], cell_m=cell * distance)
    background[rows] = ~inside
    central = near & ~background & (coverage >= in_picture)
    for plane, height in zip(planes, heights, strict=True):
        if plane.normal[2] > level:
            central |= near & _feet(means, height, central, THICKNESS * distance)
    background &= ~central
    return Proposal(near=near, background=background | (near & (coverage < in_picture)), central=central)


def _feet(
    points: Float64[np.ndarray, "G 3"],
    above_m: Float64[np.ndarray, " G"],
    plant: Bool[np.ndarray, " G"],
    thickness_m: float,
) -> Bool[np.ndarray, " G"]:
    """Find points within the ground's thickness directly below the plant: the base of its trunk."""
    feet = np.zeros(len(points), np.bool_)
    lowest = np.flatnonzero(plant & (above_m < 2 * thickness_m))
    rows = np.flatnonzero((above_m > _IN_GROUND * thickness_m) & (above_m < thickness_m))
    if len(lowest) and len(rows):
        aside = cKDTree(points[lowest, :2]).query(points[rows, :2])[0]
        feet[rows] = aside < _BELOW * thickness_m
    return feet


def _places_in_pictures(
    points: Float64[np.ndarray, "G 3"], views: list[PhotoCamera]
) -> tuple[Float64[np.ndarray, " G"], Float64[np.ndarray, " G"]]:
    """Return the share of pictures that contain each point, and its mean distance from their middle (1 at a side)."""
    coverage, total = np.zeros(len(points)), np.zeros(len(points))
    for view in views:
        x, y, depth = view.camera.project(points, view.width, view.height).T
        off = np.maximum(np.abs(2 * x / view.width - 1), np.abs(2 * y / view.height - 1))
        inside = (depth > 0) & (off < 1)
        coverage += inside
        total += np.where(inside, off, 1.0)
    return coverage / len(views), total / len(views)


def _inside_groups(
    points: Float64[np.ndarray, "G 3"],
    coverage: Bool[np.ndarray, " G"],
    middle: Float64[np.ndarray, " G"],
    *,
    cell_m: float,
) -> Bool[np.ndarray, " G"]:
    """Find the points of the most central object that the photos show whole, and of such objects near it."""
    apart_cells = 4.0  # largest gap between the plant and a loose piece of it
    if len(points) == 0:
        return np.zeros(0, np.bool_)
    cells, cell, _, group_of_cell = touching_groups(points, cell_m)
    group = group_of_cell[cell]
    number = int(group.max()) + 1
    size = np.bincount(group, minlength=number)
    whole = np.bincount(group, coverage, minlength=number) / size
    central = np.bincount(group, np.exp(-((middle / _CENTRAL) ** 2)), minlength=number)
    good = whole >= _WHOLE
    if not good.any():
        return coverage.copy()
    main = int(np.argmax(np.where(good, central, -1)))
    gap = cKDTree(cells[group_of_cell == main]).query(cells)[0]
    nearest = np.full(number, np.inf)
    np.minimum.at(nearest, group_of_cell, gap)
    chosen: Bool[np.ndarray, " G"] = (good & (nearest < apart_cells))[group]
    return chosen


def wide_planes(points: Points, cameras: Points, focus: Direction, distance_m: float) -> list[Plane]:
    """Find wide planes that have the cameras and their focus in front of them.

    Points nearer than `THICKNESS` times the distance are on a plane. RANSAC uses the points' own normals, so that a
    crown, whose points have normals in all directions, is no plane.
    """
    least_share = 0.04  # share of the points on a plane
    most_planes = 4
    trials = 400
    sampled = 8000  # points used by RANSAC
    if len(points) <= NEIGHBOURS:
        return []
    rng = np.random.default_rng(0)
    surface = flat_points(points[np.sort(rng.permutation(len(points))[:sampled])])
    least, thickness = least_share * len(surface.places), THICKNESS * distance_m
    planes: list[Plane] = []

    def score(plane: Plane) -> float:
        plane = plane.facing(focus - plane.offset * plane.normal)
        on = surface.on(plane, thickness)
        wide = on.sum() > least and _is_wall(surface.places[on], plane.normal, cameras, focus, distance_m)
        return float(on.sum()) if wide else 0.0

    while len(planes) < most_planes and len(surface.places):
        best = best_plane(surface.planes(trials, rng), score, least)
        if best is None:
            break
        plane = fit_plane(surface.places[surface.on(best, thickness)])
        planes.append(plane.facing(focus - plane.offset * plane.normal))
        surface = surface.subset(planes[-1].above(surface.places) >= thickness)
    return planes


def _is_wall(points: Points, normal: Direction, cameras: Points, focus: Direction, distance_m: float) -> bool:
    focus_gap = 0.03  # share of the cameras' distance, least gap between plane and focus
    in_front = 0.95  # share of the cameras
    least_width = 0.3  # share of the cameras' distance, least width in both directions
    middle = points.mean(axis=0)
    if (focus - middle) @ normal < focus_gap * distance_m:
        return False
    if ((cameras - middle) @ normal > 0).mean() < in_front:
        return False
    spread = np.sqrt(np.linalg.eigvalsh(np.cov((points - middle).T)))
    return bool(np.sqrt(12) * spread[1] > least_width * distance_m)
