"""The wind's frame, and how the size of a motion grows with speed and gust."""

import math

import numpy as np
from jaxtyping import Float32

from dynamictree.rotation import about_z
from dynamictree.spectrum import Wind
from dynamictree.wind_bands import DRAG_EXPONENT

REFERENCE_SPEED = 5.0  # [m/s]
MIN_SPEED = 0.1  # [m/s]
MIN_GUST = 0.01


def wind_axes(wind: Wind) -> Float32[np.ndarray, "3 3"]:
    """Return unit vectors downwind, crosswind and up, one per row."""
    return about_z(math.radians(wind.direction_deg)).T


def log_drag(wind: Wind) -> float:
    """Return ln of the drag over that at REFERENCE_SPEED; sizes are divided by it before a network learns them."""
    return DRAG_EXPONENT * math.log(max(wind.speed_m_s, MIN_SPEED) / REFERENCE_SPEED)


def log_wind_scale(wind: Wind) -> float:
    """Return ln of the motion's size over its size at drag and gust 1."""
    return log_drag(wind) + math.log(max(wind.gust, MIN_GUST))


def wind_sizes(wind: Wind, num_frequencies: int) -> Float32[np.ndarray, " K"]:
    """Return each coefficient's size over its size at drag and gust 1; the mean pose depends on the drag alone."""
    sizes = np.full(num_frequencies, np.exp(log_wind_scale(wind)), np.float32)
    sizes[0] = np.exp(log_drag(wind))
    return sizes
