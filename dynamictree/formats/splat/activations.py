"""Convert between stored values (logits, logarithms, harmonics, three of four components) and those of a cloud."""

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.special import logit

from dynamictree.gaussian.harmonics import SH_0

MIN_SCALE = 1e-10
"""Scale that is written for flat axes, as the logarithm of 0 is not finite [the file's unit]."""
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""The other components of a quaternion, by the index of its largest one."""


def logit_from_opacity(opacity: Float32[np.ndarray, " G"]) -> Float32[np.ndarray, " G"]:
    """Compute logits; 0 and 1 are clipped to the nearest values with a finite logit."""
    tiny = np.finfo(np.float32).eps / 2
    return np.asarray(logit(np.clip(opacity, tiny, 1 - tiny)), np.float32)


def scales_from_log(values: Float[np.ndarray, "G 3"]) -> Float32[np.ndarray, "G 3"]:
    """Convert logarithms to scales; an overflow becomes infinite, which validation refuses."""
    max_log_scale = 80.0  # float32 overflows at exp(88)
    return np.exp(np.where(values > max_log_scale, np.inf, values)).astype(np.float32)


def log_from_scales(scales: Float32[np.ndarray, "G 3"]) -> Float32[np.ndarray, "G 3"]:
    """Invert `scales_from_log`."""
    result: Float32[np.ndarray, "G 3"] = np.log(np.maximum(scales, np.float32(MIN_SCALE)))
    return result


def harmonic_from_color(color: Float[np.ndarray, "G 3"]) -> Float32[np.ndarray, "G 3"]:
    """Convert a view-independent colour in [0, 1] to the coefficient of degree 0."""
    return ((color - 0.5) / SH_0).astype(np.float32)


def color_from_harmonic(coefficient: Float32[np.ndarray, "G 3"]) -> Float32[np.ndarray, "G 3"]:
    """Invert `harmonic_from_color`; the result may leave [0, 1]."""
    return coefficient * np.float32(SH_0) + np.float32(0.5)


def restore_largest(others: Float32[np.ndarray, "G 3"], largest: Int[np.ndarray, " G"]) -> Float32[np.ndarray, "G 4"]:
    """Rebuild unit quaternions from three components, in order, and the index of the largest, which is not stored."""
    quaternions = np.empty((len(others), 4), np.float32)
    np.put_along_axis(quaternions, _OTHERS[largest], others, axis=1)
    rest = np.sqrt(np.maximum(0, 1 - (others * others).sum(axis=1)))
    np.put_along_axis(quaternions, largest[:, None], rest[:, None], axis=1)
    return quaternions


def drop_largest(quaternions: Float32[np.ndarray, "G 4"]) -> tuple[Float32[np.ndarray, "G 3"], Int[np.ndarray, " G"]]:
    """Invert `restore_largest`; the sign of each quaternion is chosen to make its largest component positive."""
    largest = np.abs(quaternions).argmax(axis=1)
    sign = np.where(np.take_along_axis(quaternions, largest[:, None], axis=1) < 0, np.float32(-1), np.float32(1))
    return np.take_along_axis(quaternions * sign, _OTHERS[largest], axis=1), largest
