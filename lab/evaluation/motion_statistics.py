"""Statistics of a looped motion [T, N, 3] that tell one oscillator from a crown in turbulent air."""

import numpy as np
from jaxtyping import Float32, Float64
from scipy.spatial import cKDTree

from dynamictree.spectrum import FPS

Motion = Float64[np.ndarray, "T N 3"]
FAST_HZ = 2.0
"""Trunks and branches hardly move faster; leaves flutter."""
REACH_M = 1.0  # of the pairs of places whose delay is measured
SLOW_BINS = 8  # below which gusts are larger than REACH_M
MAX_PAIRS = 40_000


def velocity(motion: Motion) -> Motion:
    """Time derivative of a loop [m/s]."""
    omega = 2j * np.pi * np.fft.rfftfreq(len(motion), d=1 / FPS)
    return np.asarray(np.fft.irfft(omega[:, None, None] * np.fft.rfft(motion, axis=0), n=len(motion), axis=0))


def effective_shapes(motion: Motion) -> float:
    """Participation ratio of the principal components: 1 where everything moves as one."""
    flat = motion.reshape(len(motion), -1)
    size = np.linalg.eigvalsh(flat @ flat.T).clip(0)
    return float(size.sum() ** 2 / (size**2).sum())


def first_shape(motion: Motion) -> float:
    """Share of the first principal component."""
    flat = motion.reshape(len(motion), -1)
    size = np.linalg.eigvalsh(flat @ flat.T).clip(0)
    return float(size[-1] / size.sum())


def off_trunk(places: Float32[np.ndarray, "N 3"], motion: Motion) -> Motion:
    """Motion less what bends as z² and z³, which is the trunk's."""
    height = (places[:, 2] - places[:, 2].min()) / np.ptp(places[:, 2])
    bends = np.stack([height**2, height**3], axis=1)
    flat = motion.transpose(1, 0, 2).reshape(len(places), -1)
    rest = flat - bends @ np.linalg.lstsq(bends, flat, rcond=None)[0]
    return np.asarray(rest.reshape(len(places), len(motion), 3).transpose(1, 0, 2))


def fast_share(motion: Motion, frame_s: float = 1 / FPS) -> float:
    """Share of the energy of the velocity above FAST_HZ."""
    power = (np.abs(np.fft.rfft(velocity(motion), axis=0)) ** 2).sum(axis=(1, 2))
    return float(power[np.fft.rfftfreq(len(motion), d=frame_s) > FAST_HZ].sum() / power.sum())


def correlation(one: Motion, other: Motion) -> float:
    """Of two motions of one tree: 1 where one is the other enlarged."""
    return float((one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum()))


def downwind_delay_s_m(places: Float32[np.ndarray, "N 3"], motion: Motion) -> float:
    """Delay per metre along +x, from the phase of the cross-spectra of near places; 1 / U where fronts travel at U."""
    near = cKDTree(places).query_pairs(REACH_M, output_type="ndarray")
    rows = near[np.random.default_rng(0).permutation(len(near))[:MAX_PAIRS]]
    ahead = (places[rows[:, 1]] - places[rows[:, 0]])[:, 0]
    rows = np.where(ahead[:, None] > 0, rows, rows[:, ::-1])[np.abs(ahead) > REACH_M / 2]
    distance = np.abs(ahead)[np.abs(ahead) > REACH_M / 2]
    bins = np.arange(1, SLOW_BINS)
    hat = np.fft.rfft(motion[..., 0], axis=0)[bins]
    together = hat[:, rows[:, 0]] * np.conj(hat[:, rows[:, 1]])
    weight = np.abs(together)
    mean_distance = (weight * distance).sum(axis=1) / weight.sum(axis=1)
    delay = np.angle(together.sum(axis=1)) / (2 * np.pi * bins * FPS / len(motion) * mean_distance)
    return float(np.average(delay, weights=weight.sum(axis=1)))
