"""Adam (Kingma and Ba 2015) on a table: a row a Gaussian, a column and a learning rate a parameter."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Int64

from dynamictree.render.kernel import compiled, in_bands

_BETA_1, _BETA_2, _EPSILON = np.float32(0.9), np.float32(0.999), np.float32(1e-15)  # Kerbl et al. 2023's
_ONE = np.float32(1)


@dataclass(frozen=True, kw_only=True)
class AdamState:
    """Moments, and how many steps they are of."""

    first: Float32[np.ndarray, "G P"]
    second: Float32[np.ndarray, "G P"]
    num_steps: int

    @classmethod
    def fresh(cls, number: int, width: int) -> "AdamState":
        """Before the first step."""
        return cls(
            first=np.zeros((number, width), np.float32), second=np.zeros((number, width), np.float32), num_steps=0
        )

    def rows(self, kept: Int64[np.ndarray, " M"], num_new: int) -> "AdamState":
        """Some rows, and new ones after them that have not moved."""
        new = np.zeros((num_new, self.first.shape[1]), np.float32)
        return AdamState(
            first=np.concatenate([self.first[kept], new]),
            second=np.concatenate([self.second[kept], new]),
            num_steps=self.num_steps,
        )


def adam_step(
    table: Float32[np.ndarray, "G P"],
    gradient: Float32[np.ndarray, "G P"],
    state: AdamState,
    rates: Float32[np.ndarray, " P"],
) -> AdamState:
    """Move the table, in place, and give the state after it (which keeps the moments' memory)."""
    steps = state.num_steps + 1
    unbias = np.array([1 / (1 - float(_BETA_1) ** steps), 1 / (1 - float(_BETA_2) ** steps)], np.float32)
    in_bands(_step, len(table), table, gradient, state.first, state.second, rates, unbias)
    return AdamState(first=state.first, second=state.second, num_steps=steps)


@compiled
@no_type_check
def _step(begin, end, table, gradient, first, second, rates, unbias):
    for g in range(begin, end):
        row, slope, m, v = table[g], gradient[g], first[g], second[g]
        for c in range(len(rates)):
            m[c] = _BETA_1 * m[c] + (_ONE - _BETA_1) * slope[c]
            v[c] = _BETA_2 * v[c] + (_ONE - _BETA_2) * slope[c] * slope[c]
            row[c] -= rates[c] * (m[c] * unbias[0]) / (np.sqrt(v[c] * unbias[1]) + _EPSILON)
