"""Gain of each mode in other winds than the spectrum's own, so that one spectrum serves all wind speeds.

The gain g_k(U) of bin k is linear in the drag D(U) between the speeds of a table; so it is exact at these speeds,
continuous between them, 0 in no wind, and constant above the last one.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from dynamictree.errors import InputError

BANDS_M_S = {"calm": 1.0, "breeze": 4.0, "wind": 8.0, "gale": 14.0, "storm": 20.0}
"""Mean wind speeds for which the model is run [m/s]."""
DRAG_EXPONENT = 1.4  # exponent of the speed up to 12 m/s: plants bend out of the way, Vogel 1989
SLOWEST_M_S, FASTEST_M_S = 0.1, 30.0


@dataclass(frozen=True, kw_only=True)
class WindBands:
    """Gains of the K bins by wind speed, relative to the spectrum's own; bin 0 is the lean. Speeds rise from 0."""

    speeds_m_s: tuple[float, ...]
    gains: tuple[tuple[float, ...], ...]  # [B][K]

    def __post_init__(self) -> None:
        max_bands = 64
        rising = all(low < high for low, high in zip(self.speeds_m_s, self.speeds_m_s[1:], strict=False))
        if not 2 <= len(self.speeds_m_s) <= max_bands or self.speeds_m_s[0] != 0 or not rising:
            raise InputError(f"speeds of wind bands are {self.speeds_m_s[:8]}; 0 and up to {max_bands - 1} rising ones")
        table = np.asarray(self.gains, np.float64)
        if len(table) != len(self.speeds_m_s) or table.ndim != 2 or not (np.isfinite(table) & (table >= 0)).all():
            raise InputError("gains of wind bands are not one row per speed, finite and at least 0")

    @property
    def num_frequencies(self) -> int:
        """Number of frequencies, K."""
        return len(self.gains[0])

    def at(self, speed_m_s: float) -> Float64[np.ndarray, " K"]:
        """Gain of each bin in a wind of this mean speed."""
        drags, table = drag_at(np.asarray(self.speeds_m_s)), np.asarray(self.gains, np.float64)
        return np.array([np.interp(drag_at(np.float64(max(speed_m_s, 0.0))), drags, column) for column in table.T])


def drag_at(speed_m_s: Float64[np.ndarray, "*S"] | np.float64) -> Float64[np.ndarray, "*S"]:
    """Return the drag D(U): U^1.4 up to 12 m/s; above, as crowns streamline, linear (docs/decisions/modal.md)."""
    return np.asarray(speed_m_s * np.minimum(speed_m_s, 12.0) ** (DRAG_EXPONENT - 1))


def power_law(speed_m_s: float, num_frequencies: int) -> WindBands:
    """Approximate the gains of a spectrum without wind bands: D(U) / D(own) for every bin, up to 30 m/s."""
    own = max(speed_m_s, SLOWEST_M_S)
    speeds = (0.0, own) if own >= FASTEST_M_S else (0.0, own, FASTEST_M_S)
    gains = drag_at(np.array(speeds)) / drag_at(np.float64(own))
    return WindBands(speeds_m_s=speeds, gains=tuple((float(gain),) * num_frequencies for gain in gains))


def bands_of_sizes(sizes: Mapping[float, Float64[np.ndarray, " K"]], own_m_s: float) -> WindBands:
    """Compute gains from each mode's size by wind speed; the spectrum's own speed has gain 1.

    Values are rounded to float32, so that a file restores them exactly.
    """
    own = sizes[own_m_s]
    rows = {
        max(speed, SLOWEST_M_S): np.divide(size, own, out=np.ones_like(own), where=own > 0)
        for speed, size in sizes.items()
    }
    speeds = sorted(rows)
    table = np.asarray([np.zeros_like(own), *(rows[speed] for speed in speeds)], np.float32)
    rounded = tuple(np.asarray([0.0, *speeds], np.float32).tolist())
    return WindBands(speeds_m_s=rounded, gains=tuple(map(tuple, table.tolist())))
