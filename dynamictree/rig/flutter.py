"""Flutter of a rig's end bones: rotations of leaves and twig ends at frequencies above the spectrum's."""

from dataclasses import replace

import numpy as np
from jaxtyping import Complex64

from dynamictree.rig.pose import GROUND
from dynamictree.rig.rig import Rig
from dynamictree.spectrum import UNKNOWN_FOLIAGE, SparseVoxelSpectrum, Wind
from dynamictree.wind.flutter import FASTEST_HZ, turn_modes

PATCH_SHARE = 0.3
"""Amplitude of a patch of a one-surface crown, which represents many leaves [share of a leaf's]."""


def flutter_modes(rig: Rig, spectrum: SparseVoxelSpectrum, size: float) -> Complex64[np.ndarray, "B L 3"]:
    """Sample rotations of the bones without children [rad], at frequencies from the spectrum's last to FASTEST_HZ.

    Args:
        rig: rig of the tree.
        spectrum: source of wind, foliage and seed, which determine the flutter.
        size: factor of the amplitude; 0 for none.
    """
    skeleton, first = rig.skeleton, spectrum.num_frequencies
    last = min(int(FASTEST_HZ * spectrum.period_s), spectrum.num_frames // 2 - 1)
    modes = np.zeros((len(skeleton), max(last + 1, first), 3), np.complex64)
    foliage = UNKNOWN_FOLIAGE if spectrum.foliage is None else spectrum.foliage
    is_end = np.ones(len(skeleton), np.bool_)
    is_end[skeleton.above] = False
    is_end &= skeleton.above != GROUND
    ends = np.flatnonzero(is_end)
    if last < first or size * foliage == 0 or len(ends) == 0:
        return modes
    rng = np.random.default_rng([spectrum.seed, len(ends)])
    along = skeleton.reach_m[ends] / np.maximum(np.linalg.norm(skeleton.reach_m[ends], axis=1, keepdims=True), 1e-9)
    across = np.cross(along, rng.standard_normal(along.shape))
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    frequency_hz = np.arange(last + 1) / spectrum.period_s
    turns = turn_modes(
        along, across.astype(np.float32), skeleton.parent[ends], spectrum.wind or Wind(), frequency_hz, rng
    )
    turns[:, :first] = 0
    share = np.where(skeleton.in_surface[ends], PATCH_SHARE, 1.0) * size * foliage
    modes[ends] = turns * share[:, None, None].astype(np.float32)
    return modes


def fluttering(rig: Rig, modes: Complex64[np.ndarray, "B L 3"]) -> Rig:
    """Return the rig with the rotations of `flutter_modes` added."""
    turns = modes.copy()
    turns[:, : rig.turns.shape[1]] += rig.turns
    return replace(rig, turns=turns)
