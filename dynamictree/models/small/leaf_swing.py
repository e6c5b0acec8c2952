"""Leaves swing about their bases: what a leaf does beyond what its base does is a turn, so it goes across the leaf.

Sizes and phases are drawn an axis at a time, and a leaf so drawn would grow and shrink along itself, until lengths are
held on the mesh and flutter is lost with that. Here the part along the leaf is taken off, and the part across it gets
its size.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Int64
from scipy.spatial import cKDTree
from torch import Tensor

from dynamictree.models.small.foliage import ARM, ARM_SCALE
from dynamictree.voxel.grid import VoxelGrid

MAX_GAIN = 2.0
BASE_VOXELS = 0.5
"""So near to its leaf's base a voxel keeps the motion it was given; from one voxel further out it swings."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Leaves:
    """For each voxel the leaf that it lies on, as far as it does."""

    base: Int64[Tensor, " V"]  # the voxel that the leaf grows from
    outward: Float32[Tensor, "V 3"]  # unit vector from there
    share: Float32[Tensor, " V"]  # 0 on wood and at a leaf's base

    def swing(self, spectrum: Complex64[Tensor, "V K 3"]) -> Complex64[Tensor, "V K 3"]:
        """The same motion, leaves turning about their bases; the mean pose (k = 0) is not made larger."""
        beyond = spectrum - spectrum[self.base]
        outward = self.outward[:, None].to(spectrum.dtype)
        across = beyond - (beyond * outward).sum(dim=2, keepdim=True) * outward
        gain = (_size(beyond) / _size(across).clamp_min(torch.finfo(torch.float32).tiny)).clamp_max(MAX_GAIN)
        gain[:, 0] = 1
        return spectrum + self.share[:, None, None] * (gain[..., None] * across - beyond)


def leaves_of(
    grid: VoxelGrid,
    told: Float32[Tensor, "V O"],
    free: Float32[Tensor, " V"],
    *,
    height_m: float,
    axes: Float32[np.ndarray, "3 3"],
) -> Leaves:
    """Leaves as the foliage network tells of them.

    Args:
        grid: of the tree.
        told: by the foliage network.
        free: 0 where the ground holds a voxel, 1 where it does not.
        height_m: of the tree.
        axes: the frame that spectra are in.
    """
    arm = told[:, ARM].numpy() * (height_m / ARM_SCALE)
    base = np.asarray(cKDTree(grid.centres_m).query(grid.centres_m - arm)[1], np.int64)
    length = np.linalg.norm(arm, axis=1)
    outward = arm @ axes.T / np.maximum(length, np.finfo(np.float32).tiny)[:, None]
    out = (length / grid.voxel_size_m - BASE_VOXELS).clip(0, 1)
    return Leaves(
        base=torch.from_numpy(base),
        outward=torch.from_numpy(outward.astype(np.float32)),
        share=free * told[:, 0].clamp(0, 1) * torch.from_numpy(out.astype(np.float32)),
    )


def _size(vectors: Complex64[Tensor, "V K 3"]) -> Float32[Tensor, "V K"]:
    size: Tensor = vectors.abs().square().sum(dim=2).sqrt()
    return size
