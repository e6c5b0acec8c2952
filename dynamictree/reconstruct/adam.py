"""Adam (Kingma and Ba 2015) on a table: one row per Gaussian, one column and learning rate per parameter."""

from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float32

from dynamictree.parallel import compiled, in_bands
from dynamictree.reconstruct.splat_state import SplatState

_BETA_1, _BETA_2, _EPSILON = np.float32(0.9), np.float32(0.999), np.float32(1e-15)  # values of Kerbl et al. 2023
_ONE = np.float32(1)


def adam_step(
    state: SplatState, gradient: Float32[np.ndarray, "G P"], rates: Float32[np.ndarray, " P"]
) -> Bool[np.ndarray, " G"]:
    """Update the table, moments and step count; return a mask of the rows skipped for a gradient that is not finite."""
    state.step += 1
    unbias = np.array([1 / (1 - float(beta) ** state.step) for beta in (_BETA_1, _BETA_2)], np.float32)
    skipped = np.zeros(len(gradient), np.bool_)
    moments = state.first, state.second
    in_bands(_step, len(gradient), state.table, gradient, *moments, rates, unbias, skipped)
    return skipped


@compiled
@no_type_check
def _step(begin, end, table, gradient, first, second, rates, unbias, skipped):
    for g in range(begin, end):
        row, slope, m, v = table[g], gradient[g], first[g], second[g]
        total = np.float32(0)
        for c in range(len(rates)):
            total += np.float32(0) * slope[c]
        if total != 0:  # 0 · ∞ and 0 · NaN are NaN
            skipped[g] = True
            continue
        for c in range(len(rates)):
            m[c] = _BETA_1 * m[c] + (_ONE - _BETA_1) * slope[c]
            v[c] = _BETA_2 * v[c] + (_ONE - _BETA_2) * slope[c] * slope[c]
            row[c] -= rates[c] * (m[c] * unbias[0]) / (np.sqrt(v[c] * unbias[1]) + _EPSILON)
