"""Adam (Kingma and Ba 2015) on a table: one row per Gaussian, one column and learning rate per parameter."""

from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Int64

from dynamictree.parallel import compiled, in_bands

_BETA_1, _BETA_2, _EPSILON = np.float32(0.9), np.float32(0.999), np.float32(1e-15)  # Kerbl et al. 2023's
_ONE = np.float32(1)


@dataclass(frozen=True, kw_only=True)
class AdamState:
    """First and second moments, and the number of steps."""

    first: Float32[np.ndarray, "G P"]
    second: Float32[np.ndarray, "G P"]
    num_steps: int

    @classmethod
    def fresh(cls, number: int, width: int) -> "AdamState":
        """Zero moments, before the first step."""
        return cls(
            first=np.zeros((number, width), np.float32), second=np.zeros((number, width), np.float32), num_steps=0
        )

    def rows(self, selected: Int64[np.ndarray, " M"], num_new: int) -> "AdamState":
        """Select rows, and append new rows with zero moments."""
        new = np.zeros((num_new, self.first.shape[1]), np.float32)
        return AdamState(
            first=np.concatenate([self.first[selected], new]),
            second=np.concatenate([self.second[selected], new]),
            num_steps=self.num_steps,
        )


class AdamStep(NamedTuple):
    """Result of one step."""

    state: AdamState
    skipped: Bool[np.ndarray, " G"]  # rows left as they were: their gradient is not finite


def adam_step(
    table: Float32[np.ndarray, "G P"],
    gradient: Float32[np.ndarray, "G P"],
    state: AdamState,
    rates: Float32[np.ndarray, " P"],
) -> AdamStep:
    """Update the table and the moments in place; rows whose gradient is not finite are skipped."""
    steps = state.num_steps + 1
    unbias = np.array([1 / (1 - float(_BETA_1) ** steps), 1 / (1 - float(_BETA_2) ** steps)], np.float32)
    skipped = np.zeros(len(table), np.bool_)
    in_bands(_step, len(table), table, gradient, state.first, state.second, rates, unbias, skipped)
    return AdamStep(AdamState(first=state.first, second=state.second, num_steps=steps), skipped)


@compiled
@no_type_check
def _step(begin, end, table, gradient, first, second, rates, unbias, skipped):
    for g in range(begin, end):
        row, slope, m, v = table[g], gradient[g], first[g], second[g]
        total = np.float32(0)
        for c in range(len(rates)):
            total += np.float32(0) * slope[c]
        if total != 0:  # NaN, from an infinity too
            skipped[g] = True
            continue
        for c in range(len(rates)):
            m[c] = _BETA_1 * m[c] + (_ONE - _BETA_1) * slope[c]
            v[c] = _BETA_2 * v[c] + (_ONE - _BETA_2) * slope[c] * slope[c]
            row[c] -= rates[c] * (m[c] * unbias[0]) / (np.sqrt(v[c] * unbias[1]) + _EPSILON)
