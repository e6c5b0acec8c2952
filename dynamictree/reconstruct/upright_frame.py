"""Estimate the vertical, the ground and the subject's region from cameras and points."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from dynamictree.planes import Plane, best_plane, fit_plane, planes_of_triples, support
from dynamictree.reconstruct.photo_cameras import nearest_to_axes
from dynamictree.reconstruct.views import SparseModel

_LEAST_UP = 0.4  # least cosine between the ground's normal and up, if the cues for up disagree
_AGREE_DEG = 5.0  # angle between agreeing cues for up, and between them and the ground's normal


@dataclass(frozen=True, kw_only=True)
class UprightFrame:
    """Frame with +Z up; its origin lies on the ground below the cameras' focus."""

    up: Float64[np.ndarray, "3"]
    origin: Float64[np.ndarray, "3"]
    radius: float  # radius of the region that the photos show, around the focus
    ground_found: bool

    @property
    def rotation(self) -> Float64[np.ndarray, "3 3"]:
        """Rotation from world to upright frame."""
        side = np.eye(3)[np.argmin(np.abs(self.up))]
        right = np.cross(side, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(self.up, right), self.up])


def find_upright_frame(model: SparseModel, rng: np.random.Generator, *, ground: bool = True) -> UprightFrame:
    """Find the vertical from the cameras' orientations, and the ground as the plane below with most points.

    If two cues agree on the vertical, an inclined plane is ground only if many points lie on it. With `ground=False`
    no ground is searched, since masks exclude it.
    """
    ground_thickness = 0.02  # share of the region's radius
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
        return UprightFrame(up=up, origin=focus + lowest * up, radius=radius, ground_found=False)
    normal, offset = plane
    return UprightFrame(up=normal, origin=focus - (focus @ normal - offset) * normal, radius=radius, ground_found=True)


def camera_up(
    positions: Float64[np.ndarray, "V 3"], rotations: Float64[np.ndarray, "V 3 3"]
) -> tuple[Float64[np.ndarray, "3"], bool]:
    """Estimate up from three cues, the photos' mean up, level right axes and a flat orbit; tell if two agree.

    Photographers hold the camera level, so its right axis is horizontal at any pitch: up is the direction in which
    the right axes vary least.
    """
    flat_orbit = 0.25  # largest height of the cameras' path over its width
    least_turn = 0.1  # share of the right axes' variance in the second direction; with less, level is ambiguous
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
    """Find the plane with most points, few points below and all cameras above by RANSAC; return normal and offset."""
    clear_ground_share, clear_ground_deg = 0.3, 15.0  # a plane of that share of the points may be steeper
    ground_share = 0.08  # share of the points near the subject that must lie on the ground
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
