"""Flutter of leaves: fast rotations above a critical wind speed, for the simulator's leaves and a rig's bones.

A leaf of critical speed U_c stands still in slower air; in faster air it twists about its axis and flaps across it with
a standard deviation that grows as a² / (1 + a²), a = U / U_c - 1. Critical speeds are lognormal: few leaves move at
2 m/s, most at 5 m/s (Beaufort scale: leaves rustle from 1.6 m/s on, leaves and small twigs move constantly from
3.4 m/s on). A leaf's natural frequency is log-uniform between 2 and 8 Hz; its line is a resonance of LINE_WIDTH. All
leaves of a twig share TWIG_SHARE of their flutter.
"""

import numpy as np
from jaxtyping import Complex64, Float, Float32, Float64, Int
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
    drawn = MEDIAN_CRITICAL_M_S * np.exp(CRITICAL_SPREAD * rng.standard_normal(count))
    speeds: Float64[np.ndarray, " M"] = np.maximum(drawn, STILL_M_S)
    return speeds


def onset(speed_m_s: Float[np.ndarray, "*M T"], critical_m_s: Float64[np.ndarray, " M"]) -> Float32[np.ndarray, "*M T"]:
    """Return the relative amplitude of each leaf's flutter, 0 to 1, at an air speed."""
    above = np.maximum(speed_m_s / critical_m_s[:, None] - 1, 0)
    return np.asarray(above**2 / (1 + above**2), np.float32)


def leaf_frequencies(count: int, rng: np.random.Generator) -> Float64[np.ndarray, " M"]:
    """Sample the natural frequency of each leaf [Hz]."""
    drawn: Float64[np.ndarray, " M"] = np.exp(rng.uniform(np.log(SLOWEST_HZ), np.log(FASTEST_HZ), count))
    return drawn


def resonance(frequency_hz: Float64[np.ndarray, " J"], own_hz: Float64[np.ndarray, " M"]) -> Float64[np.ndarray, "M J"]:
    """Return the amplitude of each leaf at each frequency of a loop; the squares sum to 1."""
    offset = (frequency_hz - own_hz[:, None]) / (LINE_WIDTH * own_hz[:, None])
    amplitude = np.sqrt(1 / (1 + offset**2)) * (frequency_hz >= SLOWEST_HZ)
    normalised: Float64[np.ndarray, "M J"] = amplitude / np.sqrt((amplitude**2).sum(axis=1, keepdims=True))
    return normalised


def unit_turns(
    twig: Int[np.ndarray, " M"], frequency_hz: Float64[np.ndarray, " J"], rng: np.random.Generator
) -> Complex64[np.ndarray, "M 2 J"]:
    """Sample spectra of each leaf's rotations across its axis and about it, of unit variance; `twig` numbers twigs."""
    twigs, own = np.unique(twig, return_inverse=True)
    own_hz = leaf_frequencies(len(twigs), rng)[own]
    of_twig, of_leaf = (
        rng.standard_normal((rows, 2, len(frequency_hz), 2), np.float32) @ np.array([1, 1j], np.complex64)
        for rows in (len(twigs), len(twig))
    )
    together = np.sqrt(TWIG_SHARE) * of_twig[own] + np.sqrt(1 - TWIG_SHARE) * of_leaf
    return np.asarray(0.5 * together * resonance(frequency_hz, own_hz)[:, None], np.complex64)


def turn_modes(
    along: Float32[np.ndarray, "M 3"],
    across: Float32[np.ndarray, "M 3"],
    twig: Int[np.ndarray, " M"],
    wind: Wind,
    frequency_hz: Float64[np.ndarray, " J"],
    rng: np.random.Generator,
) -> Complex64[np.ndarray, "M J 3"]:
    """Sample rotations of leaves in a wind at the frequencies of a loop [rad], in the convention of a spectrum.

    Args:
        along: unit vectors from a leaf's base to its tip.
        across: unit vectors about which it flaps.
        twig: number of each leaf's twig, see `unit_turns`.
        wind: wind of the loop.
        frequency_hz: frequencies of the loop up to FASTEST_HZ; those below SLOWEST_HZ stay 0.
        rng: source of frequencies, phases and critical speeds.
    """
    unit = unit_turns(twig, frequency_hz, rng)
    size = mean_onset(wind, critical_speeds(len(twig), rng))[:, None]
    flap, twist = size * FLAP_RAD * unit[:, 0], size * TWIST_RAD * unit[:, 1]  # [M, J]
    return np.asarray(flap[:, :, None] * across[:, None] + twist[:, :, None] * along[:, None], np.complex64)


def mean_onset(wind: Wind, critical_m_s: Float64[np.ndarray, " M"]) -> Float64[np.ndarray, " M"]:
    """Compute the root mean square of `onset` over the gusts of a wind."""
    quantile = (np.arange(GUSTS) + 0.5) / GUSTS
    speeds = np.maximum(wind.speed_m_s * (1 + wind.gust * ndtri(quantile)), 0)
    sizes = onset(np.broadcast_to(speeds, (len(critical_m_s), GUSTS)), critical_m_s)
    return np.asarray(np.sqrt((sizes.astype(np.float64) ** 2).mean(axis=1)))
