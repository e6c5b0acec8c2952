"""Response of stems to turbulent air: natural frequency, damping, drag, and the periodic motion that follows.

A stem is a damped oscillator per direction on its moving base. Its target is the angle at which the drag of the air
that passes it would hold it,

    θ'' + 2 ζ ω θ' + ω² θ = ω² θ_w(U + u(t) - v) + u_b'' / L,

u the turbulence at its place, v its own velocity, u_b the motion of its base. The drag goes with the relative speed
squared, less what the stem folds (Vogel). Since it takes the relative speed, air damps a moving stem the more the
stronger the wind. The periodic answer is found by alternating: drag in the time domain, dynamics in the frequency
domain (harmonic balance); the drag's own damping is taken to the left side first, so that one repetition suffices.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float, Float32, Float64
from scipy.fft import irfft, rfft

from dynamictree.modal.real_trees import LEAF_SLOWING, LEARNED_TO_M, height_law_hz, learned_law_hz
from dynamictree.spectrum import FPS

REFERENCE_SPEED_M_S = 5.0
FOLDING_SPEED_M_S, VOGEL_EXPONENT = 4.0, -0.6
"""Drag grows as U² in light air and as U^1.4 in a storm; measured Vogel exponents of trees are -0.5 to -0.8."""
LEAN_RAD = np.deg2rad(1.5)  # whole bend of a stem of REFERENCE_SLENDERNESS at the reference speed
REFERENCE_SLENDERNESS = 60.0  # L / r
LEAF_LEAN_RAD = np.deg2rad(6.0)
LEAF_OWN_DAMPING = 0.5
"""ζ of a leaf on its stalk, which is light and broad: the air stops it within a stroke."""
MAX_LEAN_RAD = np.deg2rad(20.0)  # approached, never passed
TWIST_OVER_BEND = 14.0
"""Turn of a stem about its axis over its bend, if its load sat a length to the side: 2 E I / (G J), E / G = 14."""
WIDEST_LOAD = 0.1  # of the length: leaves hold a load that is further out
STEM_DAMPING, BRANCH_DAMPING, LEAF_DAMPING = 0.02, 0.02, 0.08
"""ζ of wood, of the branches that a stem bears (each a damper of its own), and of leaves in still air: a bare tree
has 0.039, the same in leaf 2 times as much, as measured; the wind adds to it."""
SLOWEST_RATIO, FASTEST_RATIO = 0.7, 1.5  # of a stem's frequency over that of one of REFERENCE_SLENDERNESS
BIN_SAMPLES = 8
CENTRE_OF_DRAG = 0.7  # of a stem's length


@dataclass(frozen=True, kw_only=True)
class Load:
    """What each stem of a level bears."""

    foliage: Float32[np.ndarray, " M"]  # 0 bare, 1 as much for its cross-section as the trunk
    branches: Float32[np.ndarray, " M"]  # share of its wood that is its branches'
    offset: Float32[np.ndarray, "M 3"]  # from its axis to the middle of what it bears, over its length


@dataclass(frozen=True, kw_only=True)
class Oscillators:
    """Stems that begin on one ring."""

    omega: Float64[np.ndarray, " C"]  # [rad/s]
    damping_ratio: Float64[np.ndarray, " C"]  # in still air
    lean: Float64[np.ndarray, " C"]  # at the reference speed [rad]
    length_m: Float64[np.ndarray, " C"]

    def respond(
        self, air: Float32[np.ndarray, "3 C T"], base: Float32[np.ndarray, "3 C T"]
    ) -> Float32[np.ndarray, "3 C T"]:
        """Deflection of each stem [rad], in the direction in which its tip goes.

        Args:
            air: velocity of the air at each stem [m/s].
            base: displacement of what it stands on [m].
        """
        omega = frequencies(air.shape[2])
        arm = (CENTRE_OF_DRAG * self.length_m)[:, None]
        base_hat = rfft(base, axis=2)
        passing = air - irfft(1j * omega * base_hat, n=air.shape[2], axis=2)
        air_damping = self._air_damping_s(passing)[:, None]
        ratio = omega / self.omega[:, None]  # [C, W]
        damping_ratio = self.damping_ratio + self.omega * air_damping[:, 0] / 2
        transfer = of_bins(omega, self.omega, damping_ratio)
        pushed = (ratio**2 / self.length_m[:, None]) * base_hat
        target = rfft(self.static_angle(passing), axis=2)
        rate = 1j * omega * transfer * (target + pushed)  # of the angle, by the linear drag
        again = self.static_angle(passing - irfft(arm * rate, n=air.shape[2], axis=2))
        answer = transfer * (rfft(again, axis=2) + air_damping * rate + pushed)
        deflection: Float32[np.ndarray, "3 C T"] = irfft(answer, n=air.shape[2], axis=2).astype(np.float32)
        return deflection

    def static_angle(self, passing: Float[np.ndarray, "3 C T"]) -> Float[np.ndarray, "3 C T"]:
        """θ_w: the angle at which the drag of passing air would hold a stem [rad]."""
        return bounded(self.lean[:, None] * drag(passing))

    def _air_damping_s(self, passing: Float[np.ndarray, "3 C T"]) -> Float64[np.ndarray, " C"]:
        """Mean slope of θ_w over the speed, times the arm [s]: between those along the wind and across it."""
        speed = np.maximum(np.sqrt((passing**2).sum(axis=0)).mean(axis=1), 1e-3)
        mean = self.lean * pressure(speed)
        slope = 0.5 * (1 + growth_exponent(speed)) * mean / speed / (1 + (mean / MAX_LEAN_RAD) ** 2)
        damping: Float64[np.ndarray, " C"] = slope * CENTRE_OF_DRAG * self.length_m
        return damping


def oscillators(
    length_m: Float32[np.ndarray, " C"],
    radius_m: Float32[np.ndarray, " C"],
    load: Load,
    height_m: Float64[np.ndarray, " C"] | None = None,
) -> Oscillators:
    """Oscillators of stems, each of a length, a radius, and a load.

    Trunks have the frequency of their height: of measured trees, the radius tells no more (docs/laws.md).
    """
    length = length_m.astype(np.float64)
    own_hz = (
        stem_frequency_hz(length_m, radius_m, load.foliage)
        if height_m is None
        else in_leaf_hz(simulated_law_hz(height_m), load.foliage)
    )
    return Oscillators(
        omega=2 * np.pi * own_hz,
        damping_ratio=STEM_DAMPING + BRANCH_DAMPING * load.branches + LEAF_DAMPING * load.foliage.astype(np.float64),
        lean=LEAN_RAD * length / radius_m / REFERENCE_SLENDERNESS,
        length_m=length,
    )


def stem_frequency_hz(
    length_m: Float32[np.ndarray, " M"], radius_m: Float32[np.ndarray, " M"], foliage: Float32[np.ndarray, " M"]
) -> Float64[np.ndarray, " M"]:
    """Natural frequency: of real trees as high as it is long, faster if it is stout, and if it bears no leaves.

    A beam's grows with r / L²; a stouter one bears more, so that half of the exponent is left.
    """
    length = length_m.astype(np.float64)
    stoutness = np.sqrt(REFERENCE_SLENDERNESS * radius_m / length)
    by_length = simulated_law_hz(length) * np.clip(stoutness, SLOWEST_RATIO, FASTEST_RATIO)
    return in_leaf_hz(by_length, foliage)


def in_leaf_hz(
    frequency_hz: Float64[np.ndarray, " M"], foliage: Float32[np.ndarray, " M"]
) -> Float64[np.ndarray, " M"]:
    """Frequency with so much foliage, of that with half of it: measured trees were in leaf and bare."""
    return np.asarray(frequency_hz * LEAF_SLOWING ** (foliage.astype(np.float64) - 0.5))


def simulated_law_hz(length_m: Float64[np.ndarray, "*S"]) -> Float64[np.ndarray, "*S"]:
    """Frequency of a stem of REFERENCE_SLENDERNESS by its length: of real trees as high, of small ones 1 / √L.

    How fast small trees are is left to `modal.real_trees.quickening`.
    """
    return np.asarray(np.where(length_m < LEARNED_TO_M, learned_law_hz(length_m), height_law_hz(length_m)))


def drag(passing: Float[np.ndarray, "3 C T"]) -> Float[np.ndarray, "3 C T"]:
    """Force of passing air over that of the reference speed."""
    speed = np.sqrt((passing * passing).sum(axis=0))
    return np.asarray(passing * (pressure(speed) / np.maximum(speed, 1e-6)))


def pressure(speed_m_s: Float[np.ndarray, "*S"]) -> Float[np.ndarray, "*S"]:
    """Size of the force by speed, 1 at the reference speed: speed squared times what folding leaves of it."""
    folded = (1 + (speed_m_s / FOLDING_SPEED_M_S) ** 2) / (1 + (REFERENCE_SPEED_M_S / FOLDING_SPEED_M_S) ** 2)
    return np.asarray((speed_m_s / REFERENCE_SPEED_M_S) ** 2 * folded ** (VOGEL_EXPONENT / 2))


def growth_exponent(speed_m_s: Float[np.ndarray, "*S"]) -> Float[np.ndarray, "*S"]:
    """D ln pressure / d ln speed."""
    fast = speed_m_s**2 / (speed_m_s**2 + FOLDING_SPEED_M_S**2)
    return np.asarray(2 + VOGEL_EXPONENT * fast)


def bounded(angle: Float[np.ndarray, "3 C T"]) -> Float[np.ndarray, "3 C T"]:
    """Angles that stay below MAX_LEAN_RAD."""
    size = np.maximum(np.sqrt((angle * angle).sum(axis=0)), 1e-9) / MAX_LEAN_RAD
    return np.asarray(angle * (np.tanh(size) / size))


def frequencies(num_frames: int) -> Float64[np.ndarray, " W"]:
    """Of the bins of so many frames [rad/s]."""
    return np.asarray(2 * np.pi * np.fft.rfftfreq(num_frames, d=1 / FPS))


def of_bins(
    omega: Float64[np.ndarray, " W"], own: Float64[np.ndarray, " C"], damping_ratio: Float64[np.ndarray, " C"]
) -> Complex128[np.ndarray, "C W"]:
    """Transfer of oscillators to each bin of a loop: its phase, and its root mean square over the width of the bin.

    Gusts of all frequencies drive a tree; a loop has only its bins. At the bin alone, a lightly damped stem that
    happens to lie there would swing several times too far, and one between two bins not far enough.
    """
    offsets = (np.arange(BIN_SAMPLES) + 0.5) / BIN_SAMPLES - 0.5
    power = np.zeros((len(own), len(omega)))
    for offset in offsets:
        ratio = (omega + offset * omega[1]) / own[:, None]
        power += 1 / ((1 - ratio**2) ** 2 + (2 * damping_ratio[:, None] * ratio) ** 2)
    ratio = omega / own[:, None]
    centre = 1 / (1 - ratio**2 + 2j * damping_ratio[:, None] * ratio)
    transfer = np.sqrt(power / BIN_SAMPLES) * centre / np.abs(centre)
    transfer[:, 0] = 1  # the lean
    return np.asarray(transfer)


def filtered(
    series: Float[np.ndarray, "C T"],
    omega: Float64[np.ndarray, " C"],
    damping: Float64[np.ndarray, " C"] | float,
) -> Float[np.ndarray, "C T"]:
    """Answer of oscillators that stand still at their base."""
    transfer = of_bins(frequencies(series.shape[1]), omega, np.broadcast_to(damping, omega.shape))
    return np.asarray(irfft(transfer * rfft(series, axis=1), n=series.shape[1], axis=1))
