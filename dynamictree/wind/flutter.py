"""Flutter of leaves: fast rotations above a critical wind speed, for the simulator's leaves and a rig's bones.

A leaf of critical speed U_c stands still in slower air; in faster air it twists about its axis and flaps across it with
a standard deviation that grows as a² / (1 + a²), a = U / U_c - 1. Critical speeds are lognormal: few leaves move at
2 m/s, most at 5 m/s (Beaufort scale: leaves rustle from 1.6 m/s on, leaves and small twigs move constantly from
3.4 m/s on). A leaf's natural frequency is log-uniform between 2 and 8 Hz; its line is a resonance of LINE_WIDTH. All
leaves of a twig share TWIG_SHARE of their flutter.
"""

import numpy as np
from jaxtyping import Float, Float32, Float64
from scipy.special import ndtri

from dynamictree.requests import Wind

SLOWEST_HZ, FASTEST_HZ = 2.0, 8.0
"""Range observed in films of plants in wind, whose amplitude falls as f^-1.07 from 1 to 12 Hz (docs/laws.md)."""
LINE_WIDTH = 0.25
"""Half-width of a leaf's line relative to its frequency; large, since air damps leaves strongly."""
MEDIAN_CRITICAL_M_S, CRITICAL_SPREAD = 4.2, 0.3
"""Median of the critical speeds, and standard deviation of their log: 1 % of leaves move at 2.1 m/s, 72 % at 5 m/s."""
STILL_M_S = 1.5
"""Speed below which nothing flutters: Beaufort 1, "leaves do not move"."""
TWIST_RAD, FLAP_RAD = 0.35, 0.22
"""Standard deviations of a leaf's rotation in a strong wind, about its axis and across it."""
TWIG_SHARE = 0.5
"""Share of a leaf's variance that is common to all leaves of its twig."""
GUSTS = 16  # number of speeds that represent a gusty wind


def critical_speeds(count: int, rng: np.random.Generator) -> Float64[np.ndarray, " M"]:
    """Sample the speed at which each leaf begins to flutter [m/s]."""
    return np.asarray(np.maximum(MEDIAN_CRITICAL_M_S * np.exp(CRITICAL_SPREAD * rng.standard_normal(count)), STILL_M_S))


def onset(speed_m_s: Float[np.ndarray, "*M T"], critical_m_s: Float[np.ndarray, " M"]) -> Float32[np.ndarray, "*M T"]:
    """Return the relative amplitude of each leaf's flutter, 0 to 1, at an air speed."""
    above = np.maximum(speed_m_s / critical_m_s[:, None] - 1, 0)
    return np.asarray(above**2 / (1 + above**2), np.float32)


def leaf_frequencies(count: int, rng: np.random.Generator) -> Float64[np.ndarray, " M"]:
    """Sample the natural frequency of each leaf [Hz]."""
    return np.asarray(np.exp(rng.uniform(np.log(SLOWEST_HZ), np.log(FASTEST_HZ), count)))


def gust_speeds(wind: Wind) -> Float64[np.ndarray, " G"]:
    """Return speeds that are equally probable in a gusty wind [m/s]."""
    quantile = (np.arange(GUSTS) + 0.5) / GUSTS
    return np.asarray(np.maximum(wind.speed_m_s * (1 + wind.gust * ndtri(quantile)), 0))


def mean_onset(
    speeds_m_s: Float64[np.ndarray, " G"], critical_m_s: Float[np.ndarray, " M"]
) -> Float32[np.ndarray, " M"]:
    """Compute the root mean square of `onset` over equally probable speeds."""
    sizes = onset(np.broadcast_to(speeds_m_s, (len(critical_m_s), len(speeds_m_s))), critical_m_s)
    return np.asarray(np.sqrt((sizes**2).mean(axis=1)))
