"""From where a film is taken, and how large its pictures are."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from dynamictree.errors import InputError
from dynamictree.render.camera import Camera

MIN_SIDE_PX, MAX_SIDE_PX = 64, 1080
_LOW_DEG, _HIGH_DEG = -30.0, 80.0  # of the elevation: straight up or down there is no level horizon
_RIM_POINTS = 48


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A square picture, from a fixed place or from one that goes around once while the frames go by."""

    side_px: int = 512
    azimuth_deg: float = 25.0  # see `Camera.orbit`; of the first frame
    elevation_deg: float = 8.0
    orbit: bool = False
    ground: bool = True  # a level floor, with the shadow of what stands on it

    def __post_init__(self) -> None:
        if not MIN_SIDE_PX <= self.side_px <= MAX_SIDE_PX:
            raise InputError(f"side_px is {self.side_px}; {MIN_SIDE_PX} to {MAX_SIDE_PX} pixels are allowed")
        if not abs(self.azimuth_deg) <= 360:
            raise InputError(f"azimuth_deg is {self.azimuth_deg:g}; -360 to 360 are allowed")
        if not _LOW_DEG <= self.elevation_deg <= _HIGH_DEG:
            raise InputError(f"elevation_deg is {self.elevation_deg:g}; {_LOW_DEG:g} to {_HIGH_DEG:g} are allowed")

    def cameras(self, points: Float[np.ndarray, "N 3"], num_frames: int) -> list[Camera]:
        """One a frame; all of them hold the points [m], and one that goes around stays as far from them."""
        if not self.orbit:
            fixed = Camera.orbit(points, azimuth_deg=self.azimuth_deg, elevation_deg=self.elevation_deg)
            return [fixed] * num_frames
        rims = _rims(points)
        turns = self.azimuth_deg + 360 * np.arange(num_frames) / num_frames
        return [Camera.orbit(rims, azimuth_deg=float(turn), elevation_deg=self.elevation_deg) for turn in turns]


def _rims(points: Float[np.ndarray, "N 3"]) -> Float64[np.ndarray, "M 3"]:
    """Both rims of the upright cylinder around the points: it looks the same from every side."""
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    centre = (low + high) / 2
    radius = float(np.linalg.norm(points[:, :2] - centre[:2], axis=1).max())
    angle = 2 * np.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.concatenate([np.stack([x, y, np.full(_RIM_POINTS, z)], axis=1) for z in (low[2], high[2])])
