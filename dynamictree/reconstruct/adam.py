"""Adam (Kingma and Ba 2015) on a table: one row per Gaussian, one column and learning rate per parameter."""

import numpy as np
from jaxtyping import Bool, Float32

from dynamictree.reconstruct.splat_state import SplatState

_BETA_1, _BETA_2, _EPSILON = np.float32(0.9), np.float32(0.999), np.float32(1e-15)  # values of Kerbl et al. 2023


def adam_step(
    state: SplatState, gradient: Float32[np.ndarray, "G P"], rates: Float32[np.ndarray, " P"]
) -> Bool[np.ndarray, " G"]:
    """Update the table, moments and step count; return a mask of the rows skipped for a gradient that is not finite."""
    state.step += 1
    skipped: Bool[np.ndarray, " G"] = ~np.isfinite(gradient).all(axis=1)
    rows = ~skipped if skipped.any() else slice(None)
    slope = gradient[rows]
    state.first[rows] += (1 - _BETA_1) * (slope - state.first[rows])
    state.second[rows] += (1 - _BETA_2) * (slope * slope - state.second[rows])
    first, second = (1 / (1 - float(beta) ** state.step) for beta in (_BETA_1, _BETA_2))
    size = np.sqrt(state.second[rows] * np.float32(second)) + _EPSILON
    state.table[rows] -= rates * np.float32(first) * state.first[rows] / size
    return skipped
