"""Response of stems to turbulent air: natural frequency, damping, drag, and the periodic motion that follows.

A stem is a damped oscillator per direction on its moving base. Its target is its static angle under the drag of the
passing air,

    θ'' + 2 ζ ω θ' + ω² θ = ω² θ_w(U + u(t) - v) + u_b'' / L,

with turbulence u at its place, its velocity v, and its base's motion u_b. The drag grows with the square of the
relative speed, reduced by reconfiguration (Vogel). Since it depends on the relative speed, stronger wind damps more.
The periodic response alternates between drag in the time domain and dynamics in the frequency domain (harmonic
balance). The drag's own damping is first moved to the left side, so that one repetition suffices.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float, Float32, Float64
from scipy.fft import irfft, rfft

from dynamictree.modal.real_trees import LEAF_SLOWING, LEARNED_TO_M, height_law_hz, learned_law_hz
from dynamictree.spectrum import FPS
from lab.dataset.branching import Stems
from lab.dataset.leaves import Leaves

REFERENCE_SPEED_M_S = 5.0
FOLDING_SPEED_M_S, VOGEL_EXPONENT = 4.0, -0.6
"""Drag grows as U² in weak wind and as U^1.4 in a storm; measured Vogel exponents of trees are -0.5 to -0.8."""
LEAN_RAD = np.deg2rad(1.5)  # total bend of a stem of REFERENCE_SLENDERNESS at the reference speed
REFERENCE_SLENDERNESS = 60.0  # length over radius
LEAF_LEAN_RAD = np.deg2rad(6.0)
LEAF_OWN_DAMPING = 0.5
"""ζ of a leaf on its stalk: it is light and broad, so the air stops it within one swing."""
MAX_LEAN_RAD = np.deg2rad(20.0)  # asymptotic limit
TWIST_OVER_BEND = 14.0
"""Twist of a stem over its bend for a load one stem length to the side: 2 E I / (G J), E / G = 14."""
WIDEST_LOAD = 0.1  # share of the length; leaves support a load that is further out
STEM_DAMPING, BRANCH_DAMPING, LEAF_DAMPING = 0.02, 0.02, 0.08
"""ζ of wood, of a stem's branches (each of them a damper), and of leaves in still air. As measured, a bare tree has
0.039, and twice as much in leaf; wind adds to it."""
SLOWEST_RATIO, FASTEST_RATIO = 0.7, 1.5  # limits of a stem's frequency over that at REFERENCE_SLENDERNESS
SAMPLES_PER_BIN = 8
CENTRE_OF_DRAG = 0.7  # position [share of the stem's length]


@dataclass(frozen=True, kw_only=True)
class Load:
    """Load of each stem of a level."""

    foliage: Float32[np.ndarray, " M"]  # 0: bare; 1: as much per cross-section as the trunk
    branches: Float32[np.ndarray, " M"]  # share of the wood that belongs to its branches
    offset: Float32[np.ndarray, "M 3"]  # vector from the axis to the load's centre, over the length


@dataclass(frozen=True, kw_only=True)
class Oscillators:
    """Stems that begin at the same ring."""

    omega: Float64[np.ndarray, " C"]  # [rad/s]
    damping_ratio: Float64[np.ndarray, " C"]  # ratio in still air
    lean: Float64[np.ndarray, " C"]  # static angle at the reference speed [rad]
    length_m: Float64[np.ndarray, " C"]

    def respond(
        self, air: Float32[np.ndarray, "3 C T"], base: Float32[np.ndarray, "3 C T"]
    ) -> Float32[np.ndarray, "3 C T"]:
        """Return the deflection of each stem [rad], in the direction of its tip's motion.

        `air` is the velocity of the air at each stem [m/s], `base` the displacement of its base [m].
        """
        omega = frequencies(air.shape[2])
        arm = (CENTRE_OF_DRAG * self.length_m)[:, None]
        base_hat = rfft(base, axis=2)
        passing = air - irfft(1j * omega * base_hat, n=air.shape[2], axis=2)
        air_damping = self._air_damping_s(passing)[:, None]
        ratio = omega / self.omega[:, None]  # [C, W]
        damping_ratio = self.damping_ratio + self.omega * air_damping[:, 0] / 2
        transfer = bin_transfer(omega, self.omega, damping_ratio)
        pushed = (ratio**2 / self.length_m[:, None]) * base_hat
        target = rfft(self.static_angle(passing), axis=2)
        rate = 1j * omega * transfer * (target + pushed)  # rate of the angle under linear drag
        again = self.static_angle(passing - irfft(arm * rate, n=air.shape[2], axis=2))
        answer = transfer * (rfft(again, axis=2) + air_damping * rate + pushed)
        return np.asarray(irfft(answer, n=air.shape[2], axis=2), np.float32)

    def static_angle(self, passing: Float[np.ndarray, "3 C T"]) -> Float[np.ndarray, "3 C T"]:
        """Return θ_w, the static angle of a stem under the drag of the passing air [rad]."""
        return limit_angles(self.lean[:, None] * drag(passing))

    def _air_damping_s(self, passing: Float[np.ndarray, "3 C T"]) -> Float64[np.ndarray, " C"]:
        """Return the slope of θ_w over the speed, averaged along and across the wind, times the arm [s]."""
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
    """Build the oscillators of stems from lengths, radii and loads.

    A trunk's frequency depends on its height: for measured trees, the radius adds no information (docs/laws.md).
    """
    length = length_m.astype(np.float64)
    own_hz = (
        stem_frequency_hz(length_m, radius_m, load.foliage)
        if height_m is None
        else foliage_corrected_hz(simulated_law_hz(height_m), load.foliage)
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
    """Return the natural frequency of stems: that of real trees of this height, higher if stout or without leaves.

    A beam's frequency grows with r / L²; a stouter stem bears more, so half of the exponent remains.
    """
    length = length_m.astype(np.float64)
    stoutness = np.sqrt(REFERENCE_SLENDERNESS * radius_m / length)
    by_length = simulated_law_hz(length) * np.clip(stoutness, SLOWEST_RATIO, FASTEST_RATIO)
    return foliage_corrected_hz(by_length, foliage)


def foliage_corrected_hz(
    frequency_hz: Float64[np.ndarray, " M"], foliage: Float32[np.ndarray, " M"]
) -> Float64[np.ndarray, " M"]:
    """Correct a frequency for the foliage; the law is for half of it, since measured trees were in leaf and bare."""
    return np.asarray(frequency_hz * LEAF_SLOWING ** (foliage.astype(np.float64) - 0.5))


def simulated_law_hz(length_m: Float64[np.ndarray, "*S"]) -> Float64[np.ndarray, "*S"]:
    """Return the frequency of a stem of REFERENCE_SLENDERNESS: that of real trees of this height; 1 / √L if small.

    `modal.real_trees.speedup_of` corrects the frequency of small trees.
    """
    return np.asarray(np.where(length_m < LEARNED_TO_M, learned_law_hz(length_m), height_law_hz(length_m)))


def drag(passing: Float[np.ndarray, "3 C T"]) -> Float[np.ndarray, "3 C T"]:
    """Return the force of the passing air, relative to that at the reference speed."""
    speed = np.sqrt((passing * passing).sum(axis=0))
    return np.asarray(passing * (pressure(speed) / np.maximum(speed, 1e-6)))


def pressure(speed_m_s: Float[np.ndarray, "*S"]) -> Float[np.ndarray, "*S"]:
    """Return the size of the force by speed, 1 at the reference speed: speed squared, reduced by reconfiguration."""
    folded = (1 + (speed_m_s / FOLDING_SPEED_M_S) ** 2) / (1 + (REFERENCE_SPEED_M_S / FOLDING_SPEED_M_S) ** 2)
    return np.asarray((speed_m_s / REFERENCE_SPEED_M_S) ** 2 * folded ** (VOGEL_EXPONENT / 2))


def growth_exponent(speed_m_s: Float[np.ndarray, "*S"]) -> Float[np.ndarray, "*S"]:
    """Return d ln pressure / d ln speed."""
    fast = speed_m_s**2 / (speed_m_s**2 + FOLDING_SPEED_M_S**2)
    return np.asarray(2 + VOGEL_EXPONENT * fast)


def limit_angles(angle: Float[np.ndarray, "3 C T"]) -> Float[np.ndarray, "3 C T"]:
    """Limit angles smoothly to MAX_LEAN_RAD."""
    size = np.maximum(np.sqrt((angle * angle).sum(axis=0)), 1e-9) / MAX_LEAN_RAD
    return np.asarray(angle * (np.tanh(size) / size))


def frequencies(num_frames: int) -> Float64[np.ndarray, " W"]:
    """Return the angular frequencies of the bins for a number of frames [rad/s]."""
    return np.asarray(2 * np.pi * np.fft.rfftfreq(num_frames, d=1 / FPS))


def bin_transfer(
    omega: Float64[np.ndarray, " W"], own: Float64[np.ndarray, " C"], damping_ratio: Float64[np.ndarray, " C"]
) -> Complex128[np.ndarray, "C W"]:
    """Return the oscillators' transfer function at each bin of a loop: its phase, and its RMS over the bin's width.

    Gusts of all frequencies drive a tree, but a loop has only its bins. With the value at the bin alone, a lightly
    damped stem would swing several times too far if its frequency is near a bin, and too little between bins.
    """
    offsets = (np.arange(SAMPLES_PER_BIN) + 0.5) / SAMPLES_PER_BIN - 0.5
    power = np.zeros((len(own), len(omega)))
    for offset in offsets:
        ratio = (omega + offset * omega[1]) / own[:, None]
        power += 1 / ((1 - ratio**2) ** 2 + (2 * damping_ratio[:, None] * ratio) ** 2)
    ratio = omega / own[:, None]
    centre = 1 / (1 - ratio**2 + 2j * damping_ratio[:, None] * ratio)
    transfer = np.sqrt(power / SAMPLES_PER_BIN) * centre / np.abs(centre)
    transfer[:, 0] = 1  # bin 0 is the static lean
    return np.asarray(transfer)


def driven_response(
    series: Float[np.ndarray, "C T"], omega: Float64[np.ndarray, " C"], damping: Float64[np.ndarray, " C"] | float
) -> Float[np.ndarray, "C T"]:
    """Return the response of oscillators with a fixed base."""
    transfer = bin_transfer(frequencies(series.shape[1]), omega, np.broadcast_to(damping, omega.shape))
    return np.asarray(irfft(transfer * rfft(series, axis=1), n=series.shape[1], axis=1))


def loads_of(levels: tuple[Stems, ...], leaves: tuple[Leaves, ...], *, bare: bool) -> list[Load]:
    """Return the loads by level. In a tree with clumps of foliage, all stems bear as much as the trunk."""
    wood = [np.pi * base_radius(stems).astype(np.float64) ** 2 * stems.length_m / 3 for stems in levels]
    foliage = [np.zeros(len(stems.points)) for stems in levels]
    weighted = [own[:, None] * ring_centre(stems) for own, stems in zip(wood, levels, strict=True)]
    borne = [own.copy() for own in wood]
    for bunch in leaves:
        area = bunch.length_m.astype(np.float64) ** 2
        np.add.at(foliage[bunch.level], bunch.row, area)
    for depth in range(len(levels) - 1, -1, -1):
        stems = levels[depth]
        for first in sorted(set(stems.first.tolist()), reverse=True):
            rows = np.flatnonzero(stems.first == first)
            if first == 0 and depth == 0:
                continue
            above = depth if first else depth - 1
            for sums in (foliage, weighted, borne):
                np.add.at(sums[above], stems.parent[rows], sums[depth][rows])
    loads = []
    for depth, stems in enumerate(levels):
        section = foliage[depth] / base_radius(stems) ** 2
        if depth == 0:
            rooted = stems.first == 0
            whole = foliage[0][rooted].sum() / (base_radius(stems)[rooted] ** 2).sum()
        share = np.clip(section / whole, 0, 1) if whole > 0 and depth else np.full(len(section), 0.0 if bare else 1.0)
        offset = (weighted[depth] / borne[depth][:, None] - ring_centre(stems)) / stems.length_m[:, None]
        far = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True) / WIDEST_LOAD, 1)
        loads.append(
            Load(
                foliage=share.astype(np.float32),
                branches=(1 - wood[depth] / borne[depth]).astype(np.float32),
                offset=(offset / far).astype(np.float32),
            )
        )
    return loads


def base_radius(stems: Stems) -> Float32[np.ndarray, " M"]:
    """Return the radius at a stem's base [m]."""
    radius: Float32[np.ndarray, " M"] = stems.radii[np.arange(len(stems.points)), stems.first]
    return radius


def ring_centre(stems: Stems) -> Float64[np.ndarray, "M 3"]:
    """Return the mean position of a stem's own rings [m]."""
    own = np.arange(stems.segments + 1) >= stems.first[:, None]
    middle: Float64[np.ndarray, "M 3"] = (stems.points * own[:, :, None]).sum(axis=1) / own.sum(axis=1)[:, None]
    return middle
