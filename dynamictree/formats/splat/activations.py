"""Convert between stored values (logits, logarithms, harmonics, three of four components) and those of a cloud."""

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.special import expit, logit

from dynamictree.gaussian.harmonics import SH_0

MIN_SCALE = 1e-10
"""Flat axes are written as this, not as zero, whose logarithm is not finite [the file's unit]."""
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Components of a quaternion beside its largest one."""


def opacity_from_logit(values: Float[np.ndarray, " G"]) -> Float32[np.ndarray, " G"]:
    """Sigmoid."""
    return expit(values.astype(np.float32))


def logit_from_opacity(opacity: Float32[np.ndarray, " G"]) -> Float32[np.ndarray, " G"]:
    """Undoes `opacity_from_logit`; 0 and 1, which have no finite logit, become the nearest that have."""
    tiny = np.finfo(np.float32).eps / 2
    result: Float32[np.ndarray, " G"] = logit(np.clip(opacity, tiny, 1 - tiny)).astype(np.float32)
    return result


def scales_from_log(values: Float[np.ndarray, "G 3"]) -> Float32[np.ndarray, "G 3"]:
    """Exponential; what would overflow becomes infinite, which validation refuses."""
    max_log_scale = 80.0  # float32 ends at exp(88); more is no length but an overflow
    return np.exp(np.where(values > max_log_scale, np.inf, values)).astype(np.float32)


def log_from_scales(scales: Float32[np.ndarray, "G 3"]) -> Float32[np.ndarray, "G 3"]:
    """Undoes `scales_from_log`."""
    result: Float32[np.ndarray, "G 3"] = np.log(np.maximum(scales, np.float32(MIN_SCALE)))
    return result


def harmonic_from_color(color: Float[np.ndarray, "G 3"]) -> Float32[np.ndarray, "G 3"]:
    """The first harmonic's coefficient of a colour in [0, 1] that is the same from everywhere."""
    return ((color - 0.5) / SH_0).astype(np.float32)


def color_from_harmonic(coefficient: Float32[np.ndarray, "G 3"]) -> Float32[np.ndarray, "G 3"]:
    """Undoes `harmonic_from_color`; may leave [0, 1]."""
    return coefficient * np.float32(SH_0) + np.float32(0.5)


def with_largest(others: Float32[np.ndarray, "G 3"], largest: Int[np.ndarray, " G"]) -> Float32[np.ndarray, "G 4"]:
    """Unit quaternions from three components, in their order, and the place of the one that is not stored."""
    quaternions = np.empty((len(others), 4), np.float32)
    np.put_along_axis(quaternions, _OTHERS[largest], others, axis=1)
    rest = np.sqrt(np.maximum(0, 1 - (others * others).sum(axis=1)))
    np.put_along_axis(quaternions, largest[:, None], rest[:, None], axis=1)
    return quaternions


def without_largest(
    quaternions: Float32[np.ndarray, "G 4"],
) -> tuple[Float32[np.ndarray, "G 3"], Int[np.ndarray, " G"]]:
    """Undoes `with_largest`: of the two signs of each quaternion the one whose largest component is positive."""
    largest = np.abs(quaternions).argmax(axis=1)
    sign = np.where(np.take_along_axis(quaternions, largest[:, None], axis=1) < 0, np.float32(-1), np.float32(1))
    return np.take_along_axis(quaternions * sign, _OTHERS[largest], axis=1), largest
