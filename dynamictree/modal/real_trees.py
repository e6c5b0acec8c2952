"""Natural frequency and damping of real trees by height and foliage, and their use for a spectrum's modes.

Frequencies: 58 measured broadleaf trees of 12 to 56 m (TobyDJackson/WindAndTrees_NaturalFrequencies, field data),
f = 0.66 H^-0.41 Hz. The table has no tree below 12 m; there the law is extrapolated as 1 / H, as for similar beams.
Damping: damped cosines fitted to 19 pull-and-release records of Wytham Woods (same source), median 0.13 in leaf (10
records) and 0.039 bare (9). The frequencies of trees 14, 16 and 20 in leaf are 0.79 to 0.94 times those bare.
"""

import numpy as np
from jaxtyping import Float64

from dynamictree.spectrum import FPS, NUM_FRAMES, UNKNOWN_FOLIAGE

MEASURED_FROM_M = 12.0
FITTED_HEIGHTS_M = (2.0, 56.0)
"""Range of the law; smaller plants get the 1.4 Hz of 2 m, since 16 frequencies in 4.17 s cannot show twice as much."""
LEARNED_TO_M = 8.0
"""Height below which the frequency of trees in version 5 of the data set, the training set of the shipped weights,
grows only as 1 / √L, since 16 frequencies in 4.17 s end at 3.6 Hz."""
LEAF_SLOWING = 0.85  # ratio of the frequencies in leaf and bare
LEAST_BINS = 2
"""Least number of a loop's bins, without the lean, up to the lowest natural frequency."""


def height_law_hz(height_m: float | Float64[np.ndarray, "*S"]) -> Float64[np.ndarray, "*S"]:
    """Return the lowest natural frequency of real trees by height, extrapolated to short ones as for similar beams."""
    law = 0.66 * np.maximum(height_m, MEASURED_FROM_M) ** -0.41
    return np.asarray(law * np.maximum(MEASURED_FROM_M / height_m, 1))


def natural_frequency_hz(height_m: float, foliage: float | None) -> float:
    """Return a tree's lowest natural frequency [Hz]; foliage is 0 for bare, 1 for in leaf, None if unknown."""
    bounded = float(np.clip(height_m, *FITTED_HEIGHTS_M))
    return float(height_law_hz(bounded) * LEAF_SLOWING ** (_or_mean(foliage) - 0.5))


def learned_law_hz(length_m: float | Float64[np.ndarray, "*S"]) -> Float64[np.ndarray, "*S"]:
    """Return the frequency of a stem of up to LEARNED_TO_M by its length, as in the shipped weights' training set."""
    return np.asarray(height_law_hz(LEARNED_TO_M) * np.sqrt(LEARNED_TO_M / length_m))


def speedup_of(height_m: float) -> float:
    """Return the factor by which a small tree sways faster than by the model's 1 / √L; at least 1."""
    max_quickening = 2.5
    height = max(height_m, 1e-3)
    return float(np.clip(height_law_hz(height) / learned_law_hz(height), 1, max_quickening))


def natural_damping(foliage: float | None) -> float:
    """Return the damping ratio after a released pull, between the medians of bare trees and trees in leaf."""
    bare_damping_ratio, leaf_damping_ratio = 0.039, 0.13
    share = _or_mean(foliage)
    return float(bare_damping_ratio ** (1 - share) * leaf_damping_ratio**share)


def _or_mean(foliage: float | None) -> float:
    return UNKNOWN_FOLIAGE if foliage is None else foliage


def loop_times(height_m: float) -> int:
    """Return the loop length, in multiples of the paper's 4.17 s, for a tree of this height."""
    # Longest loop, 16.7 s. Trees above 29 m would need more.
    max_loop_times = 4
    slowest_s = LEAST_BINS / natural_frequency_hz(height_m, foliage=0.5)
    return int(np.clip(np.ceil(slowest_s * FPS / NUM_FRAMES), 1, max_loop_times))


def loop_period_s(height_m: float) -> float:
    """Return the period of the loop for a tree of this height [s]."""
    return loop_times(height_m) * NUM_FRAMES / FPS


def free_omega(wind_omega: Float64[np.ndarray, " M"], frequency_hz: float) -> Float64[np.ndarray, " M"]:
    """Compute the natural frequencies of the modes [rad/s] for a lowest frequency `frequency_hz`.

    The same stiffness is added to all modes, ω² = ω_wind² + ω_0² - ω_wind,1². Modes with bins below the tree's natural
    frequency are its quasi-static motion in wind, and oscillate at about that frequency; high modes hardly change.
    """
    omega: Float64[np.ndarray, " M"] = np.sqrt(wind_omega**2 + (2 * np.pi * frequency_hz) ** 2 - wind_omega[0] ** 2)
    return omega
