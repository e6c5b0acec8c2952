"""Cameras of a shot: one fixed camera, or one that orbits the tree."""

import numpy as np
from jaxtyping import Float, Float64

from dynamictree.render.camera import Camera
from dynamictree.requests import Shot


def cameras_of(shot: Shot, points: Float[np.ndarray, "N 3"], num_frames: int) -> list[Camera]:
    """One camera per frame. Each has all points [m] in view; a camera that orbits keeps its distance to them."""
    if not shot.orbit:
        fixed = Camera.orbit(points, azimuth_deg=shot.azimuth_deg, elevation_deg=shot.elevation_deg)
        return [fixed] * num_frames
    rims = _rims(points)
    turns = shot.azimuth_deg + 360 * np.arange(num_frames) / num_frames
    return [Camera.orbit(rims, azimuth_deg=float(turn), elevation_deg=shot.elevation_deg) for turn in turns]


def _rims(points: Float[np.ndarray, "N 3"]) -> Float64[np.ndarray, "M 3"]:
    """Points on both rims of the upright cylinder around the points, which looks the same from every side [m]."""
    rim_points = 48
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    centre = (low + high) / 2
    radius = float(np.linalg.norm(points[:, :2] - centre[:2], axis=1).max())
    angle = 2 * np.pi * np.arange(rim_points) / rim_points
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.concatenate([np.stack([x, y, np.full(rim_points, z)], axis=1) for z in (low[2], high[2])])
