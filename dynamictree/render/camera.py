"""Pinhole cameras, fixed or orbiting a tree."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

from dynamictree.requests import Shot

_MARGIN = 1.06  # factor of the tightest framing


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Pinhole camera with axes x right, y down, z forward, as in OpenCV and COLMAP; the world is +Z up.

    Focal length and principal point are shares of the picture, so that one camera fits pictures of any size.
    """

    position_m: Float64[np.ndarray, "3"]
    world_to_camera: Float64[np.ndarray, "3 3"]  # rows: right, down and forward in the world
    focal: float  # [picture heights]
    centre: tuple[float, float] = (0.5, 0.5)  # principal point, as shares of width and height

    @classmethod
    def look_at(
        cls,
        position_m: Float[np.ndarray, "3"],
        target_m: Float[np.ndarray, "3"],
        *,
        vertical_fov_deg: float = 32.0,
    ) -> "Camera":
        """Create a camera that looks from one point to another, with a level horizon."""
        forward = np.asarray(target_m, np.float64) - position_m
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])  # [3, 3]
        focal = 0.5 / np.tan(np.radians(vertical_fov_deg) / 2)
        return cls(position_m=np.asarray(position_m, np.float64), world_to_camera=rotation, focal=float(focal))

    @classmethod
    def orbit(
        cls,
        points: Float[np.ndarray, "N 3"],
        *,
        azimuth_deg: float = 25.0,
        elevation_deg: float = 8.0,
        aspect: float = 1.0,
    ) -> "Camera":
        """Create the nearest camera that shows all points, aimed at the centre of their bounding box.

        At azimuth 0 the camera is at −Y and looks along +Y, with +X to the right; the azimuth grows anticlockwise seen
        from above. Points are in metres; the aspect is the picture's width over its height.
        """
        low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
        target = (low + high) / 2
        azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
        away = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
        aimed = cls.look_at(target + away, target)
        x, y, z = aimed.world_to_camera @ (points - target).T  # [N] each
        half_height = 0.5 / aimed.focal / _MARGIN  # tangent of the largest half angle of the points
        # a point at depth d + z is inside if |y| <= (d + z) * half_height, and likewise for x
        distance = float(np.maximum(np.abs(y) / half_height - z, np.abs(x) / (half_height * aspect) - z).max())
        return cls.look_at(target + away * distance, target)

    def intrinsics_px(self, width: int, height: int) -> Float64[np.ndarray, "3 3"]:
        """Return the matrix from camera axes to pixels, with pixel centres at half-integers."""
        focal = self.focal * height
        return np.array([[focal, 0, self.centre[0] * width], [0, focal, self.centre[1] * height], [0, 0, 1.0]])

    def project(self, points: Float[np.ndarray, "N 3"], width: int, height: int) -> Float64[np.ndarray, "N 3"]:
        """Project points to pixel x, y and depth along the axis [m], which is negative behind the camera."""
        in_camera = (points - self.position_m) @ self.world_to_camera.T  # [N, 3]
        in_picture = in_camera @ self.intrinsics_px(width, height).T  # [N, 3], times the depth
        return np.concatenate([in_picture[:, :2] / in_picture[:, 2:], in_picture[:, 2:]], axis=1)


def points_in_view(points: Float[np.ndarray, "N 3"], moving: Bool[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Select the points that a picture must contain: the plant, and still parts near its foot, such as a pot."""
    low, high = points[moving].min(axis=0), points[moving].max(axis=0)
    height = high[2] - low[2]
    reach = max(float((high - low)[:2].max()), float(height)) / 2
    beside = np.linalg.norm(points[:, :2] - (low + high)[:2] / 2, axis=1)
    near = (beside < reach) & (points[:, 2] > low[2] - height) & (points[:, 2] < high[2])
    return np.asarray(moving | near)


def cameras_of(shot: Shot, points: Float[np.ndarray, "N 3"], num_frames: int) -> list[Camera]:
    """Return one camera per frame, with all points [m] in view; an orbiting camera has a constant distance."""
    if not shot.orbit:
        fixed = Camera.orbit(points, azimuth_deg=shot.azimuth_deg, elevation_deg=shot.elevation_deg)
        return [fixed] * num_frames
    rims = _rims(points)
    turns = shot.azimuth_deg + 360 * np.arange(num_frames) / num_frames
    return [Camera.orbit(rims, azimuth_deg=float(turn), elevation_deg=shot.elevation_deg) for turn in turns]


def _rims(points: Float[np.ndarray, "N 3"]) -> Float64[np.ndarray, "M 3"]:
    """Return points on both rims of the upright cylinder around the points [m]."""
    rim_points = 48
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    centre = (low + high) / 2
    radius = float(np.linalg.norm(points[:, :2] - centre[:2], axis=1).max())
    angle = 2 * np.pi * np.arange(rim_points) / rim_points
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.concatenate([np.stack([x, y, np.full(rim_points, z)], axis=1) for z in (low[2], high[2])])
