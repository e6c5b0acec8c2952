"""Flutter of a rig's end bones: rotations of leaves and twig ends at frequencies above the spectrum's.

A leaf flaps about an axis a across its bone and twists about its bone's direction d. At phase p of the loop and in air
of speed U its bone has, beside its other rotations,

    θ(p) = share · onset(U / critical) · √½ Σ_j (FLAP_RAD a cos 2π(n_j p + α_j) + TWIST_RAD d cos 2π(n_j p + β_j)),

a sum of tones, half of which the leaves of a twig share. In gusty wind onset is its root mean square over the speeds of
the gusts. Files for the page and for engines have the same few numbers per bone, and their readers evaluate this sum.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex64, Float32, Float64, Int64, UInt8

from dynamictree.rig.pose import GROUND
from dynamictree.rig.rig import Rig
from dynamictree.spectrum import UNKNOWN_FOLIAGE, SparseVoxelSpectrum, Wind
from dynamictree.wind import flutter as leaf

TWIG_END_SHARE = 0.3
"""Amplitude of the end of a stem, which bends from its parent [share of a leaf's]; at 1 its edges stretch by 1.3 %."""


@dataclass(frozen=True, kw_only=True)
class Flutter:
    """Tones of B bones. Bones that carry others have the share 0."""

    axis: Float32[np.ndarray, "B 3"]  # unit vector a
    tones: UInt8[np.ndarray, "B J 3"]  # n_j, 0 where the spectrum has this frequency; α_j and β_j in 1/256
    critical_m_s: Float32[np.ndarray, " B"]
    share: Float32[np.ndarray, " B"]
    period_s: float

    def sizes(self, speeds_m_s: Float64[np.ndarray, " G"]) -> Float32[np.ndarray, " B"]:
        """Compute share · onset of each bone in air that has each of these speeds equally often."""
        return np.asarray(self.share * leaf.mean_onset(speeds_m_s, self.critical_m_s))

    def modes(self, directions: Float32[np.ndarray, "B 3"], least: int) -> Complex64[np.ndarray, "B L 3"]:
        """Return the spectrum of θ [rad] where share · onset is 1, of at least so many frequencies."""
        periods = self.tones[..., 0].astype(np.int64)
        modes = np.zeros((len(periods), max(least, int(periods.max(initial=0)) + 1), 3), np.complex64)
        flap, twist = np.exp(2j * np.pi / 256 * np.moveaxis(self.tones[..., 1:, None], 2, 0).astype(np.float32))
        turns = leaf.FLAP_RAD * flap * self.axis[:, None] + leaf.TWIST_RAD * twist * directions[:, None]
        np.add.at(modes, (np.arange(len(periods))[:, None], periods), np.sqrt(1 / 8) * turns)
        modes[:, 0] = 0
        return modes


def flutter_of(rig: Rig, spectrum: SparseVoxelSpectrum, size: float = 1.0) -> Flutter:
    """Sample the flutter of leaf cards and ends of stems, from the period, foliage, frequencies and seed of a spectrum.

    Two tones are a leaf's own, two its twig's, as half of its variance is (`TWIG_SHARE`). `size` is a factor on all
    shares: 0 for none, 1 as in nature. Bones in a crown that is one surface have none: its edges would stretch by 9 %.
    """
    skeleton, carriers = rig.skeleton, rig.vertices
    leaf_m = 0.3  # reach of the simulator's leaf cards; a longer card is many leaves, which do not flutter together
    is_end = (skeleton.above != GROUND) & ~skeleton.in_surface
    is_end[skeleton.above] = False
    foliage = UNKNOWN_FOLIAGE if spectrum.foliage is None else spectrum.foliage
    as_leaf = leaf_m / np.maximum(np.linalg.norm(skeleton.reach_m, axis=1), leaf_m)
    as_leaf[carriers.rows[carriers.shares[:, 1] > 0, 0]] *= TWIG_END_SHARE
    rng = np.random.default_rng([spectrum.seed, len(skeleton)])
    twigs, twig = np.unique(skeleton.above, return_inverse=True)
    across = np.cross(skeleton.directions, rng.standard_normal((len(skeleton), 3)))
    own_hz = leaf.leaf_frequencies(len(twigs), rng)
    tones = np.concatenate([_tones(own_hz, spectrum, rng)[twig], _tones(own_hz[twig], spectrum, rng)], axis=1)
    return Flutter(
        axis=(is_end[:, None] * across / np.linalg.norm(across, axis=1, keepdims=True)).astype(np.float32),
        tones=(is_end[:, None, None] * tones).astype(np.uint8),
        critical_m_s=leaf.critical_speeds(len(skeleton), rng).astype(np.float32),
        share=(size * foliage * is_end * as_leaf).astype(np.float32),
        period_s=spectrum.period_s,
    )


def fluttering(rig: Rig, spectrum: SparseVoxelSpectrum, size: float) -> Rig:
    """Return the rig with flutter added to its loop, in the spectrum's wind; `size` is that of `flutter_of`."""
    flutter = flutter_of(rig, spectrum, size)
    sizes = flutter.sizes(leaf.gust_speeds(spectrum.wind or Wind()))
    turns = sizes[:, None, None] * flutter.modes(rig.skeleton.directions, rig.turns.shape[1])
    turns[:, : rig.turns.shape[1]] += rig.turns
    return replace(rig, turns=turns)


def _tones(
    own_hz: Float64[np.ndarray, " M"], spectrum: SparseVoxelSpectrum, rng: np.random.Generator
) -> Int64[np.ndarray, "M 2 3"]:
    """Sample tones of the resonance at each frequency: its power is a Cauchy distribution, cut to the measured band."""
    own_hz = own_hz[:, None]
    low, high = (np.arctan((end - own_hz) / (leaf.LINE_WIDTH * own_hz)) for end in (leaf.SLOWEST_HZ, leaf.FASTEST_HZ))
    draws = rng.random((len(own_hz), 2, 3))
    drawn_hz = own_hz * (1 + leaf.LINE_WIDTH * np.tan(low + (high - low) * draws[..., 0]))
    periods = np.rint(drawn_hz * spectrum.period_s)
    highest = min(int(leaf.FASTEST_HZ * spectrum.period_s), spectrum.num_frames // 2 - 1)
    periods[(periods < spectrum.num_frequencies) | (periods > highest)] = 0
    return np.concatenate([periods[..., None], np.floor(256 * draws[..., 1:])], axis=2).astype(np.int64)
