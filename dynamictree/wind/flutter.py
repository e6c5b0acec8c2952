"""Flutter of leaves: fast turns that set in with the wind's speed.

A leaf of critical speed U_c stands still in slower air; above it, it twists about its axis and flaps across it with a
standard deviation that grows as a² / (1 + a²), a = U / U_c - 1. Critical speeds are lognormal: few leaves move in
2 m/s, most in 5 m/s (the Beaufort scale: leaves rustle from 1.6 m/s on, leaves and small twigs move constantly from
3.4 m/s on). A leaf's own frequency is drawn between 2 and 8 Hz, evenly in the logarithm; its line is a resonance of
LINE_WIDTH.
"""

import numpy as np
from jaxtyping import Float, Float32, Float64

SLOWEST_HZ, FASTEST_HZ = 2.0, 8.0
"""Seen in films of plants in wind, whose amplitude falls as f^-1.07 from 1 to 12 Hz (docs/laws.md)."""
LINE_WIDTH = 0.25
"""Half-width of a leaf's line over its frequency: the air damps leaves strongly."""
MEDIAN_CRITICAL_M_S, CRITICAL_SPREAD = 4.2, 0.3
"""Median of the critical speeds, and the deviation of their logarithm: 1 % of leaves move in 2.1 m/s, 72 % in 5 m/s."""
STILL_M_S = 1.5
"""Below it nothing flutters: Beaufort 1, "leaves do not move"."""
TWIST_RAD, FLAP_RAD = 0.35, 0.22
"""Standard deviations of a leaf's turn in a strong wind, about its axis and across it."""


def critical_speeds(count: int, rng: np.random.Generator) -> Float64[np.ndarray, " M"]:
    """Speed at which each leaf begins to flutter [m/s]."""
    drawn = MEDIAN_CRITICAL_M_S * np.exp(CRITICAL_SPREAD * rng.standard_normal(count))
    speeds: Float64[np.ndarray, " M"] = np.maximum(drawn, STILL_M_S)
    return speeds


def onset(speed_m_s: Float[np.ndarray, "*M T"], critical_m_s: Float64[np.ndarray, " M"]) -> Float32[np.ndarray, "*M T"]:
    """Size of the flutter of each leaf, 0 to 1, in air that passes it at a speed."""
    above = np.maximum(speed_m_s / critical_m_s[:, None] - 1, 0)
    size: Float32[np.ndarray, "*M T"] = (above**2 / (1 + above**2)).astype(np.float32)
    return size


def leaf_frequencies(count: int, rng: np.random.Generator) -> Float64[np.ndarray, " M"]:
    """Own frequency of each leaf [Hz]."""
    drawn: Float64[np.ndarray, " M"] = np.exp(rng.uniform(np.log(SLOWEST_HZ), np.log(FASTEST_HZ), count))
    return drawn


def line(frequency_hz: Float64[np.ndarray, " J"], own_hz: Float64[np.ndarray, " M"]) -> Float64[np.ndarray, "M J"]:
    """Amplitude of each leaf at each frequency of a loop; the sum of squares is 1."""
    offset = (frequency_hz - own_hz[:, None]) / (LINE_WIDTH * own_hz[:, None])
    amplitude = np.sqrt(1 / (1 + offset**2)) * (frequency_hz >= SLOWEST_HZ)
    normalised: Float64[np.ndarray, "M J"] = amplitude / np.sqrt((amplitude**2).sum(axis=1, keepdims=True))
    return normalised
