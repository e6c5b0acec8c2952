"""Animate a bound cloud frame by frame, without the whole motion in memory."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np
from jaxtyping import Complex64, Float32

from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.cloud import GaussianCloud, level_of_detail
from dynamictree.gaussian.deform import Deformer, Pose, apply_pose
from dynamictree.rig.flutter import Flutter

LeafTurns = Iterable[Float32[np.ndarray, "M 3"] | None]
"""θ of each leaf of a binding, frame by frame [rad]; None where nothing flutters."""
NO_FLUTTER: LeafTurns = repeat(None)


@dataclass(frozen=True, kw_only=True)
class AnimatedSplat:
    """Bound cloud with the spectrum of its mesh's vertices: all data of a player, a few MB besides the cloud."""

    binding: Binding
    coefficients: Complex64[np.ndarray, "N K 3"]  # spectrum of the binding's vertices [m]
    num_frames: int  # number of frames T of the spectrum
    fps: float
    flutter: Flutter | None = None  # flutter of the leaves


def iter_poses(
    binding: Binding, displacements: Iterable[Float32[np.ndarray, "N 3"]], leaf_turns: LeafTurns = NO_FLUTTER
) -> Iterator[Pose]:
    """Yield one pose per frame; the displacements of the mesh's vertices [m] are consumed one by one."""
    deformer = Deformer(binding)
    for displacement, turns in zip(displacements, leaf_turns, strict=False):
        yield deformer.pose(displacement, turns)


def iter_splat_frames(
    binding: Binding, displacements: Iterable[Float32[np.ndarray, "N 3"]], leaf_turns: LeafTurns = NO_FLUTTER
) -> Iterator[GaussianCloud]:
    """Yield one cloud per frame, with colours rotated like their Gaussians: the paper's output."""
    for pose in iter_poses(binding, displacements, leaf_turns):
        yield apply_pose(binding.cloud, pose)


def reduced_splat(binding: Binding, *, share: float = 1.0, sh_degree: int = 3) -> Binding:
    """Reduce a bound cloud: fewer Gaussians (see `cloud.level_of_detail`), fewer harmonics, the same motion.

    Raises:
        InputError: the share is not in (0, 1].
    """
    cloud, rows = level_of_detail(binding.cloud, share)
    cloud = cloud.with_sh_degree(sh_degree)
    leaves = None if binding.leaves is None else replace(binding.leaves, of=binding.leaves.of[rows])
    return replace(binding, cloud=cloud, face_of=binding.face_of[rows], weights=binding.weights[rows], leaves=leaves)
