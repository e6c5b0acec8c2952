"""Flutter of leaves: rotations at frequencies above the spectrum's, of a rig's end bones or of a cloud's leaves.

A leaf flaps about an axis a across it and twists about its direction d. At phase p of the loop and in air of speed U it
has, beside its other rotations,

    θ(p) = share · onset(U / critical) · √½ Σ_j (FLAP_RAD a cos 2π(n_j p + α_j) + TWIST_RAD d cos 2π(n_j p + β_j)),

a sum of tones, half of which the leaves of a twig share. In gusty wind onset is its root mean square over the speeds of
the gusts. Files for the page and for engines have the same few numbers per leaf, and their readers evaluate this sum.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np
from jaxtyping import Complex64, Float, Float32, Float64, Int, Int64, UInt8

from dynamictree.rig.pose import GROUND
from dynamictree.rig.rig import Rig
from dynamictree.spectrum import UNKNOWN_FOLIAGE, SparseVoxelSpectrum, Wind, iter_motion
from dynamictree.wind import flutter as leaf

TWIG_END_SHARE = 0.3
"""Amplitude of the end of a stem, which bends from its parent [share of a leaf's]; at 1 its edges stretch by 1.3 %."""


@dataclass(frozen=True, kw_only=True)
class Flutter:
    """Tones of B bones or leaves. Bones that carry others have the share 0."""

    direction: Float32[np.ndarray, "B 3"]  # unit vector d
    axis: Float32[np.ndarray, "B 3"]  # unit vector a
    tones: UInt8[np.ndarray, "B J 3"]  # n_j, 0 where the spectrum has this frequency; α_j and β_j in 1/256
    critical_m_s: Float32[np.ndarray, " B"]
    share: Float32[np.ndarray, " B"]
    period_s: float
    wind: Wind  # wind of the loop

    @property
    def gusts_m_s(self) -> Float64[np.ndarray, " G"]:
        """Speeds of the loop's wind, equally often."""
        return leaf.gust_speeds(self.wind)

    @property
    def tensors(self) -> dict[str, np.ndarray]:
        """What a player needs, by the names in the files (docs/formats.md)."""
        return {
            "turn_direction": self.direction,
            "flutter_axis": self.axis,
            "flutter_tones": self.tones,
            "flutter_critical_m_s": self.critical_m_s,
            "flutter_share": self.share,
        }

    def sizes(self, speeds_m_s: Float64[np.ndarray, " G"]) -> Float32[np.ndarray, " B"]:
        """Compute share · onset of each bone in air that has each of these speeds equally often."""
        return np.asarray(self.share * leaf.mean_onset(speeds_m_s, self.critical_m_s))

    def modes(self, least: int = 1) -> Complex64[np.ndarray, "B L 3"]:
        """Return the spectrum of θ [rad] where share · onset is 1, of at least so many frequencies."""
        periods = self.tones[..., 0].astype(np.int64)
        modes = np.zeros((len(periods), max(least, int(periods.max(initial=0)) + 1), 3), np.complex64)
        flap, twist = np.exp(2j * np.pi / 256 * np.moveaxis(self.tones[..., 1:, None], 2, 0).astype(np.float32))
        turns = leaf.FLAP_RAD * flap * self.axis[:, None] + leaf.TWIST_RAD * twist * self.direction[:, None]
        np.add.at(modes, (np.arange(len(periods))[:, None], periods), np.sqrt(1 / 8) * turns)
        modes[:, 0] = 0
        return modes

    def theta(
        self, phases: Float64[np.ndarray, " M"], num_frames: int, speeds_m_s: Float64[np.ndarray, " M"] | None = None
    ) -> Iterator[Float32[np.ndarray, "B 3"]]:
        """Yield θ at phases of a loop of T frames [rad], each in air of its own speed; by default in the loop's gusts.

        The phases are in periods.
        """
        air = repeat(self.gusts_m_s) if speeds_m_s is None else speeds_m_s[:, None]
        for turns, speeds in zip(iter_motion(self.modes(), phases, num_frames), air, strict=False):
            yield self.sizes(speeds)[:, None] * turns


def flutter_of(rig: Rig, spectrum: SparseVoxelSpectrum, size: float = 1.0) -> Flutter:
    """Sample the flutter of leaf cards and ends of stems, from the period, foliage, frequencies and seed of a spectrum.

    `size` is a factor on all shares: 0 for none, 1 as in nature. Bones in a crown that is one surface, and those at
    which a surface forks, have none: their edges would stretch by 9 and 33 %.
    """
    skeleton, carriers, above = rig.skeleton, rig.vertices, rig.skeleton.above
    is_end = (above != GROUND) & ~skeleton.in_surface
    is_end[above] = False
    share = float(size) * is_end
    reach_m = np.linalg.norm(skeleton.reach_m, axis=1)
    apart = skeleton.foot_m - (skeleton.foot_m + skeleton.reach_m)[above]
    bends = np.linalg.norm(apart, axis=1) < 1e-3 * reach_m  # a bone that goes on from its parent's end in one surface
    share[bends & (np.bincount(above[bends], minlength=len(above))[above] > 1)] = 0
    bends[carriers.rows[carriers.shares[:, 1] > 0, 0]] = True
    share[bends] *= TWIG_END_SHARE
    return sample_flutter(skeleton.directions, reach_m, above, share, spectrum)


def sample_flutter(
    direction: Float32[np.ndarray, "B 3"],
    reach_m: Float[np.ndarray, " B"],
    twig: Int[np.ndarray, " B"],
    share: Float64[np.ndarray, " B"],
    spectrum: SparseVoxelSpectrum,
) -> Flutter:
    """Sample the flutter of leaves of these directions, reaches, twigs and shares of a leaf's amplitude.

    Two tones are a leaf's own, two its twig's, as half of its variance is (`TWIG_SHARE`).
    """
    leaf_m = 0.3  # reach of the simulator's leaf cards; a longer card is many leaves, which do not flutter together
    some, count = share > 0, len(share)
    foliage = UNKNOWN_FOLIAGE if spectrum.foliage is None else spectrum.foliage
    rng = np.random.default_rng([spectrum.seed, count])
    twigs, twig = np.unique(twig, return_inverse=True)
    across = np.cross(direction, rng.standard_normal((count, 3)))
    own_hz = leaf.leaf_frequencies(len(twigs), rng)
    tones = np.concatenate([_tones(own_hz, spectrum, rng)[twig], _tones(own_hz[twig], spectrum, rng)], axis=1)
    return Flutter(
        direction=direction,
        axis=(some[:, None] * across / np.linalg.norm(across, axis=1, keepdims=True)).astype(np.float32),
        tones=(some[:, None, None] * tones).astype(np.uint8),
        critical_m_s=leaf.critical_speeds(count, rng).astype(np.float32),
        share=(foliage * share * leaf_m / np.maximum(reach_m, leaf_m)).astype(np.float32),
        period_s=spectrum.period_s,
        wind=spectrum.wind or Wind(),
    )


def fluttering(rig: Rig, spectrum: SparseVoxelSpectrum, size: float) -> Rig:
    """Return the rig with flutter added to its loop, in the spectrum's wind; `size` is that of `flutter_of`."""
    flutter = flutter_of(rig, spectrum, size)
    sizes = flutter.sizes(flutter.gusts_m_s)
    turns = sizes[:, None, None] * flutter.modes(rig.turns.shape[1])
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
