"""Natural frequency and damping of real trees by height and foliage, and how a spectrum's modes take them over.

Frequencies: 58 measured broadleaf trees of 12 to 56 m (TobyDJackson/WindAndTrees_NaturalFrequencies, field data),
f = 0.66 H^-0.41 Hz. Below 12 m that table has no tree, and the law goes on as 1 / H, as beams of like shape do: an
extrapolation. Damping: damped cosines fitted to 19 pull-and-release records of Wytham Woods (same source), median
0.13 in leaf (10 records) and 0.039 bare (9). Trees 14, 16 and 20 are 0.79 to 0.94 times as fast in leaf as bare.
"""

import numpy as np
from jaxtyping import Float64

from dynamictree.spectrum import FPS, NUM_FRAMES, UNKNOWN_FOLIAGE

MEASURED_FROM_M = 12.0
FITTED_HEIGHTS_M = (2.0, 56.0)
"""A plant of 1 m has the frequency of one of 2 m, 1.4 Hz: twice as much is above what 16 frequencies in 4.17 s show."""
LEARNED_TO_M = 8.0
"""Height below which trees of version 5 of the data set, which the shipped weights learned from, get faster as 1 / √L
only: 16 frequencies in 4.17 s end at 3.6 Hz."""
LEAF_SLOWING = 0.85  # frequency in leaf over bare
LEAST_BINS = 2
"""Of a loop's spectrum, the lean not counted, up to the lowest natural frequency."""


def height_law_hz(height_m: float | Float64[np.ndarray, "*S"]) -> Float64[np.ndarray, "*S"]:
    """Lowest natural frequency of real trees by height, and of shorter ones as of beams of like shape."""
    law = 0.66 * np.maximum(height_m, MEASURED_FROM_M) ** -0.41
    return np.asarray(law * np.maximum(MEASURED_FROM_M / height_m, 1))


def natural_frequency_hz(height_m: float, foliage: float | None) -> float:
    """Lowest natural frequency of a tree [Hz]; foliage is 0 for a bare tree, 1 for a tree in leaf, None if unknown."""
    bounded = float(np.clip(height_m, *FITTED_HEIGHTS_M))
    return float(height_law_hz(bounded) * LEAF_SLOWING ** (_or_middle(foliage) - 0.5))


def learned_law_hz(length_m: float | Float64[np.ndarray, "*S"]) -> Float64[np.ndarray, "*S"]:
    """Frequency of a stem of up to LEARNED_TO_M by its length, as the shipped weights learned it."""
    return np.asarray(height_law_hz(LEARNED_TO_M) * np.sqrt(LEARNED_TO_M / length_m))


def quickening(height_m: float) -> float:
    """How much faster a small tree sways than the model's 1 / √L says; 1 where nature is not faster."""
    max_quickening = 2.5
    height = max(height_m, 1e-3)
    return float(np.clip(height_law_hz(height) / learned_law_hz(height), 1, max_quickening))


def natural_damping(foliage: float | None) -> float:
    """Damping ratio of a released pull, between the medians of bare trees and trees in leaf."""
    bare_damping_ratio, leaf_damping_ratio = 0.039, 0.13
    share = _or_middle(foliage)
    return float(bare_damping_ratio ** (1 - share) * leaf_damping_ratio**share)


def _or_middle(foliage: float | None) -> float:
    return UNKNOWN_FOLIAGE if foliage is None else foliage


def loop_times(height_m: float) -> int:
    """Length of the loop in which a tree of this height sways at its own pace, over the paper's 4.17 s."""
    # Longest loop that a height chooses, over the paper's: 16.7 s. Trees above 29 m would want more.
    max_loop_times = 4
    slowest_s = LEAST_BINS / natural_frequency_hz(height_m, foliage=0.5)
    return int(np.clip(np.ceil(slowest_s * FPS / NUM_FRAMES), 1, max_loop_times))


def loop_period_s(height_m: float) -> float:
    """Period that a tree of this height chooses [s]."""
    return loop_times(height_m) * NUM_FRAMES / FPS


def free_omega(wind_omega: Float64[np.ndarray, " M"], frequency_hz: float) -> Float64[np.ndarray, " M"]:
    """Natural frequencies of the modes [rad/s] when the lowest is `frequency_hz`.

    One stiffness is added to all modes, ω² = ω_wind² + ω_0² - ω_wind,1². Modes whose bins lie below the tree's own
    frequency are its quasi-static motion in wind, and ring at its own frequency; high modes hardly change.
    """
    omega: Float64[np.ndarray, " M"] = np.sqrt(wind_omega**2 + (2 * np.pi * frequency_hz) ** 2 - wind_omega[0] ** 2)
    return omega
