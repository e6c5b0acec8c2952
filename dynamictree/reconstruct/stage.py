"""Up, ground and region of the subject, from cameras and points alone."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from dynamictree.planes import Plane, best_plane, fit_plane, planes_of_triples, support
from dynamictree.reconstruct.photo_cameras import nearest_to_axes
from dynamictree.reconstruct.views import SparseModel

_LEAST_UP = 0.4  # cosine between the ground's normal and up, where the cameras' cues for up disagree
_AGREE_DEG = 5.0  # between cues for up; and between the ground's normal and cues that agree


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A frame with +Z up whose origin lies on the ground below the middle of what the cameras look at."""

    up: Float64[np.ndarray, "3"]
    origin: Float64[np.ndarray, "3"]
    radius: float  # of the region that the pictures hold, around the point they look at
    ground_found: bool

    @property
    def rotation(self) -> Float64[np.ndarray, "3 3"]:
        """World to stage."""
        side = np.eye(3)[np.argmin(np.abs(self.up))]
        right = np.cross(side, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(self.up, right), self.up])


def find_stage(model: SparseModel, rng: np.random.Generator, *, ground: bool = True) -> Stage:
    """Find the vertical from the photos' orientations, and the ground as the plane below that has most points.

    Where two cues of the cameras agree on up, a plane that leans away from it is no ground, unless most points lie on
    it. With `ground=False` none is searched: masks leave it out.
    """
    ground_thickness = 0.02  # of the region's radius
    positions = np.array([view.camera.position_m for view in model.views])
    up, cues_agree = camera_up(positions, np.array([view.camera.world_to_camera for view in model.views]))
    focus = nearest_to_axes([view.camera for view in model.views])
    distance = np.linalg.norm(positions - focus, axis=1)
    half_sides = [0.5 * max(1.0, view.image.shape[1] / view.image.shape[0]) / view.camera.focal for view in model.views]
    radius = float(np.median(distance * half_sides))
    near = model.points[np.linalg.norm(model.points - focus, axis=1) < 1.5 * radius]
    plane = None
    if ground:
        plane = _ground_plane(near, positions, up, ground_thickness * radius, rng, cues_agree=cues_agree)
    if plane is None:
        lowest = np.percentile((near - focus) @ up, 1) if len(near) else -radius
        return Stage(up=up, origin=focus + lowest * up, radius=radius, ground_found=False)
    normal, offset = plane
    return Stage(up=normal, origin=focus - (focus @ normal - offset) * normal, radius=radius, ground_found=True)


def camera_up(
    positions: Float64[np.ndarray, "V 3"], rotations: Float64[np.ndarray, "V 3 3"]
) -> tuple[Float64[np.ndarray, "3"], bool]:
    """Up from three cues, and whether at least two agree: the photos' mean up, level right axes, a flat orbit.

    Photographers hold the camera level, so its right axis is horizontal whatever the pitch: up is the direction that
    right axes have least of.
    """
    flat_orbit = 0.25  # height of the cameras' path over its width
    least_turn = 0.1  # of the photos' right axes that must point aside, or the cameras do not tell what is level
    mean_up = -rotations[:, 1].sum(axis=0)
    mean_up /= np.linalg.norm(mean_up)
    cues = [mean_up]
    _, spreads, axes = np.linalg.svd(rotations[:, 0], full_matrices=False)
    if spreads[1] ** 2 > least_turn * len(positions):
        cues.insert(0, axes[2] * np.sign(axes[2] @ mean_up))
    _, widths, axes = np.linalg.svd(positions - positions.mean(axis=0), full_matrices=False)
    if widths[2] < flat_orbit * widths[1]:
        cues.append(axes[2] * np.sign(axes[2] @ mean_up))
    agreeing = [sum(first @ second > np.cos(np.radians(_AGREE_DEG)) for second in cues) for first in cues]
    best = int(np.argmax(agreeing))
    return (cues[best], True) if agreeing[best] > 1 else (mean_up, False)


def _ground_plane(
    points: Float64[np.ndarray, "P 3"],
    cameras: Float64[np.ndarray, "V 3"],
    up: Float64[np.ndarray, "3"],
    thickness: float,
    rng: np.random.Generator,
    *,
    cues_agree: bool,
) -> tuple[Float64[np.ndarray, "3"], float] | None:
    """Normal and offset of the plane with most points on it, few below, and all cameras above (RANSAC)."""
    clear_ground_share, clear_ground_deg = 0.3, 15.0  # a plane of that many points may lean more: a slope
    ground_share = 0.08  # of the points near the subject must lie on a plane that is called ground
    trials = 400
    if len(points) < 50:
        return None
    least_up = np.cos(np.radians(clear_ground_deg)) if cues_agree else _LEAST_UP

    def score(plane: Plane) -> float:
        plane = plane.facing(up)
        if plane.normal @ up < least_up or plane.above(cameras).min() < 0:
            return -np.inf
        own = support(plane.above(points), thickness)
        leans = cues_agree and plane.normal @ up < np.cos(np.radians(_AGREE_DEG))
        return -np.inf if leans and own < clear_ground_share * len(points) else own

    best = best_plane(planes_of_triples(points, trials, rng), score, ground_share * len(points))
    if best is None:
        return None
    ground = fit_plane(points[np.abs(best.above(points)) < thickness]).facing(up)
    return ground.normal, ground.offset
