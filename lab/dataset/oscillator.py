"""Response of one stem to wind: its lean, its natural frequency, and its motion in gusts.

A stem of length L is one damped oscillator a direction, of natural frequency 0.955 / √L Hz (the law of Sapling, whose
b = 1 / (4 √L) is in radians a frame of 1/24 s). The drag's mean bends it downwind by an angle θ that grows with L / r;
gusts drive it around that, and so does the motion of its base on the parent. The answer at bin k is

    q_k = H(k) (gust a_k θ e^{iψ_k} + (k / k_s)² u_k / L),    H(k) = 1 / (1 − (k / k_s)² + 2iζ k / k_s),

k_s the stem's own bin, u_k the motion of its base [m], ψ_k a phase: near the same for all stems at low k, of each
stem's own at high k. Geometry and wind fix the amplitude, chance the phase. A tree without leaves is lighter, so that
its stems are faster, and has little to brake it (`modal.real_trees`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.modal.real_trees import (
    BARE_DAMPING_RATIO,
    FREQUENCY_AT_1M_HZ,
    LEAF_SLOWING,
    TALL_EXPONENT,
    TALL_M,
)
from dynamictree.spectrum import FPS, NUM_FRAMES, NUM_FREQUENCIES, Wind

REFERENCE_SPEED_M_S = 5.0
DRAG_EXPONENT = 1.6  # of the speed: leaves and twigs fold; `MAX_LEAN_RAD` takes its share of the answer too
LEAN_RAD = np.deg2rad(1.5)  # whole bend of a stem of REFERENCE_SLENDERNESS at the reference speed
REFERENCE_SLENDERNESS = 60.0  # L / r
LEAF_LEAN_RAD = np.deg2rad(6.0)
MAX_LEAN_RAD = np.deg2rad(20.0)  # approached, never passed
DAMPING_RATIO = 0.15  # of a tree in leaf, mostly aerodynamic; 0.13 was measured
TURBULENCE_EXPONENT = 0.5  # a_k ~ k^-0.5: wakes in the crown make the spectrum flatter than the free stream's
PHASE_SPREAD_RAD = 0.12  # a bin and a level: how far a stem's phase strays from its parent's
DRIVE = np.array([1.0, 0.5, 0.35], np.float32)  # along the wind, level across it, and vertical
SLOWEST_CARRIER_M_S = 1.0  # gusts travel no slower than this, or their phase would wind up in a calm


@dataclass(frozen=True, kw_only=True)
class Gusts:
    """Amplitude and phase of the wind at each gust frequency, shared by the whole tree."""

    wind: Wind
    bins: Float64[np.ndarray, " J"]  # in units of fps / T; whole numbers in a loop of T frames
    phase: Float32[np.ndarray, "J 3"]  # [rad]
    axes: Float32[np.ndarray, "3 3"]  # rows: downwind, level across, up

    @property
    def amplitude(self) -> Float64[np.ndarray, " J"]:
        """a_k: of unit variance together."""
        power = self.bins ** (-2 * TURBULENCE_EXPONENT)
        amplitude: Float64[np.ndarray, " J"] = np.sqrt(2 * power / power.sum())
        return amplitude


def gusts_of(wind: Wind, rng: np.random.Generator, *, loop: bool = True, times: int = 1) -> Gusts:
    """Gust frequencies: all bins up to K of a loop of `times` T frames, or, free, one at random near each."""
    bins = np.arange(1, NUM_FREQUENCIES * times) / times
    if not loop:
        bins = bins + rng.uniform(-0.5, 0.5, len(bins)) / times
    heading = np.deg2rad(wind.direction_deg)
    cosine, sine = np.cos(heading), np.sin(heading)
    return Gusts(
        wind=wind,
        bins=bins,
        phase=rng.uniform(0, 2 * np.pi, (len(bins), 3)).astype(np.float32),
        axes=np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], np.float32),
    )


def damping_ratio(*, bare: bool) -> float:
    """ζ of every stem of a tree."""
    return BARE_DAMPING_RATIO if bare else DAMPING_RATIO


def stem_bin(length_m: Float32[np.ndarray, " M"], *, bare: bool = False) -> Float64[np.ndarray, " M"]:
    """k_s: natural frequency of a stem in units of a bin; falls with length, as 1 / L above `TALL_M`."""
    length = length_m.astype(np.float64)
    frequency_hz = FREQUENCY_AT_1M_HZ / np.sqrt(length) * np.minimum(TALL_M / length, 1) ** (TALL_EXPONENT - 0.5)
    return frequency_hz / (LEAF_SLOWING if bare else 1.0) * NUM_FRAMES / FPS


def lean_angle(
    length_m: Float32[np.ndarray, " M"], radius_m: Float32[np.ndarray, " M"], speed_m_s: float
) -> Float64[np.ndarray, " M"]:
    """θ: how far the mean wind bends a stem [rad]; grows with slenderness and speed, below MAX_LEAN_RAD."""
    linear = LEAN_RAD * _drag(speed_m_s) * length_m.astype(np.float64) / radius_m / REFERENCE_SLENDERNESS
    lean: Float64[np.ndarray, " M"] = MAX_LEAN_RAD * np.tanh(linear / MAX_LEAN_RAD)
    return lean


def leaf_lean_angle(speed_m_s: float) -> float:
    """θ of a leaf [rad]."""
    return float(MAX_LEAN_RAD * np.tanh(LEAF_LEAN_RAD * _drag(speed_m_s) / MAX_LEAN_RAD))


def answer(
    gusts: Gusts,
    lean: Float64[np.ndarray, " M"],
    own_bin: Float64[np.ndarray, " M"],
    phase: Float32[np.ndarray, "M J 3"],
    base_angle: Complex64[np.ndarray, "M J 3"],
    *,
    damping: float = DAMPING_RATIO,
) -> Complex64[np.ndarray, "M J 3"]:
    """q_k at the gusts' frequencies, in wind axes: `2 |q|` is an amplitude [rad]. `base_angle` is u_k / L."""
    ratio = gusts.bins / own_bin[:, None]  # [M, J]
    transfer = 1 / (1 - ratio**2 + 2j * damping * ratio)
    drive = (gusts.wind.gust * gusts.amplitude * lean[:, None])[:, :, None] * DRIVE * np.exp(1j * phase)
    reply: Complex64[np.ndarray, "M J 3"] = transfer[:, :, None] * (drive + (ratio**2)[:, :, None] * base_angle)
    return reply.astype(np.complex64)


def stray(gusts: Gusts, count: int, rng: np.random.Generator) -> Float32[np.ndarray, "M J 3"]:
    """Draw the phase offsets of `count` stems from their parents [rad]."""
    spread = PHASE_SPREAD_RAD * gusts.bins[:, None]
    return (spread * rng.standard_normal((count, len(gusts.bins), 3), np.float32)).astype(np.float32)


def delay(gusts: Gusts, base: Float32[np.ndarray, "M 3"]) -> Float32[np.ndarray, "M J 1"]:
    """Phase by which a gust comes later downwind: it travels with the wind [rad]."""
    seconds = base @ gusts.axes[0] / max(gusts.wind.speed_m_s, SLOWEST_CARRIER_M_S)
    late: Float32[np.ndarray, "M J"] = 2 * np.pi * gusts.bins * FPS / NUM_FRAMES * seconds[:, None]
    return late.astype(np.float32)[:, :, None]


def clock(gusts: Gusts, num_frames: int) -> Complex64[np.ndarray, "J T"]:
    """2 e^{iωt} at the gusts' frequencies: Re(q @ clock) is the motion."""
    turn = 2j * np.pi * gusts.bins[:, None] * np.arange(num_frames) / NUM_FRAMES
    ticks: Complex64[np.ndarray, "J T"] = (2 * np.exp(turn)).astype(np.complex64)
    return ticks


def _drag(speed_m_s: float) -> float:
    """Mean force of the wind against that at the reference speed."""
    return float((speed_m_s / REFERENCE_SPEED_M_S) ** DRAG_EXPONENT)
