"""Where the tree stands: up, ground and region, from cameras and points alone."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from dynamictree.reconstruct.views import SparseModel

_TRIALS = 400
_GROUND_SHARE = 0.08  # of the points near the subject must lie on a plane that is called ground
_GROUND_THICKNESS = 0.02  # of the region's radius
_LEAST_UP = 0.4  # cosine between the ground's normal and the cameras' mean up


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
    """The cameras look at the subject from around, upright; the ground is the plane below that holds most points.

    Without `ground` none is sought: it is cut out of the photos.
    """
    positions = np.array([view.camera.position_m for view in model.views])
    forward = np.array([view.camera.world_to_camera[2] for view in model.views])
    up = -np.array([view.camera.world_to_camera[1] for view in model.views]).sum(axis=0)
    up /= np.linalg.norm(up)
    focus = _nearest_to_axes(positions, forward)
    distance = np.linalg.norm(positions - focus, axis=1)
    half_sides = [0.5 * max(1.0, view.image.shape[1] / view.image.shape[0]) / view.camera.focal for view in model.views]
    radius = float(np.median(distance * half_sides))
    near = model.points[np.linalg.norm(model.points - focus, axis=1) < 1.5 * radius]
    plane = _ground_plane(near, positions, up, _GROUND_THICKNESS * radius, rng) if ground else None
    if plane is None:
        lowest = np.percentile((near - focus) @ up, 1) if len(near) else -radius
        return Stage(up=up, origin=focus + lowest * up, radius=radius, ground_found=False)
    normal, offset = plane
    return Stage(up=normal, origin=focus - (focus @ normal - offset) * normal, radius=radius, ground_found=True)


def _nearest_to_axes(
    positions: Float64[np.ndarray, "V 3"], forward: Float64[np.ndarray, "V 3"]
) -> Float64[np.ndarray, "3"]:
    """The point of least squared distance to all viewing axes; axes that run alike still meet at the mean distance."""
    projectors = np.eye(3) - forward[:, :, None] * forward[:, None, :]  # [V, 3, 3]
    point: Float64[np.ndarray, 3] = np.linalg.lstsq(
        projectors.sum(axis=0), np.einsum("vij,vj->i", projectors, positions), rcond=None
    )[0]
    return point


def _ground_plane(
    points: Float64[np.ndarray, "P 3"],
    cameras: Float64[np.ndarray, "V 3"],
    up: Float64[np.ndarray, "3"],
    thickness: float,
    rng: np.random.Generator,
) -> tuple[Float64[np.ndarray, "3"], float] | None:
    """Normal and offset of the plane with most points on it, few below and all cameras above (RANSAC)."""
    if len(points) < 50:
        return None
    best, best_score = None, _GROUND_SHARE * len(points)
    for corners in rng.integers(0, len(points), (_TRIALS, 3)):
        a, b, c = points[corners]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length == 0:
            continue
        normal *= np.sign(normal @ up) / length
        if normal @ up < _LEAST_UP or (cameras @ normal - normal @ a).min() < 0:
            continue
        score = _support(points @ normal - normal @ a, thickness)
        if score > best_score:
            best, best_score = (normal, float(normal @ a)), score
    if best is None:
        return None
    on_plane = np.abs(points @ best[0] - best[1]) < thickness
    middle = points[on_plane].mean(axis=0)
    normal = np.linalg.svd(points[on_plane] - middle, full_matrices=False)[2][2]
    normal *= np.sign(normal @ up)
    return normal, float(normal @ middle)


def _support(height: Float64[np.ndarray, " P"], thickness: float) -> float:
    return float((np.abs(height) < thickness).sum() - 2 * (height < -thickness).sum())
