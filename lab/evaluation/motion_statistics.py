"""Statistics of a looped motion [T, N, 3] that distinguish one oscillator from a crown in turbulent air."""

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.spectrum import FPS

Motion = Float64[np.ndarray, "T N 3"]
FAST_HZ = 2.0
"""Frequency above which trunks and branches hardly move, but leaves flutter."""


def velocity(motion: Motion) -> Motion:
    """Return the time derivative of a loop [m/s]."""
    omega = 2j * np.pi * np.fft.rfftfreq(len(motion), d=1 / FPS)
    return np.asarray(np.fft.irfft(omega[:, None, None] * np.fft.rfft(motion, axis=0), n=len(motion), axis=0))


def effective_shapes(motion: Motion) -> float:
    """Return the participation ratio of the principal components; 1 if everything moves as one."""
    flat = motion.reshape(len(motion), -1)
    size = np.linalg.eigvalsh(flat @ flat.T).clip(0)
    return float(size.sum() ** 2 / (size**2).sum())


def without_trunk_motion(places: Float32[np.ndarray, "N 3"], motion: Motion) -> Motion:
    """Subtract the part of the motion that bends as z² and z³, which is the trunk's."""
    height = (places[:, 2] - places[:, 2].min()) / np.ptp(places[:, 2])
    bends = np.stack([height**2, height**3], axis=1)
    flat = motion.transpose(1, 0, 2).reshape(len(places), -1)
    rest = flat - bends @ np.linalg.lstsq(bends, flat, rcond=None)[0]
    return np.asarray(rest.reshape(len(places), len(motion), 3).transpose(1, 0, 2))


def fast_share(motion: Motion, frame_s: float = 1 / FPS) -> float:
    """Return the share of the velocity's energy above FAST_HZ."""
    power = (np.abs(np.fft.rfft(velocity(motion), axis=0)) ** 2).sum(axis=(1, 2))
    return float(power[np.fft.rfftfreq(len(motion), d=frame_s) > FAST_HZ].sum() / power.sum())


def correlation(one: Motion, other: Motion) -> float:
    """Return the correlation of two motions of one tree; 1 if one is a scaled copy of the other."""
    return float((one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum()))
