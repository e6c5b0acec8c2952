"""Project a leaf's motion relative to its base onto rotations, so that leaves do not stretch.

Sizes and phases are drawn per axis, so a leaf would grow and shrink along itself; restoring its lengths on the mesh
would then remove flutter. This module removes the component along the leaf and rescales the component across it.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Int64
from scipy.spatial import cKDTree
from torch import Tensor

from dynamictree.models.small.foliage import ARM, ARM_SCALE
from dynamictree.models.small.spread import squared_magnitude
from dynamictree.voxel.grid import VoxelGrid

MAX_LEAF_GAIN = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Leaves:
    """Leaf of each voxel: base, direction and weight."""

    base: Int64[Tensor, " V"]  # voxel that the leaf grows from; for wood, the voxel itself
    outward: Float32[Tensor, "V 3"]  # unit vector from the base to the voxel
    share: Float32[Tensor, " V"]  # 0 on wood and at a leaf's base

    def swing(self, spectrum: Complex64[Tensor, "V K 3"]) -> Complex64[Tensor, "V K 3"]:
        """Replace the leaves' motion by rotations about their bases; the mean pose (k = 0) does not grow."""
        beyond = spectrum - spectrum[self.base]
        outward = self.outward[:, None].to(spectrum.dtype)
        across = beyond - (beyond * outward).sum(dim=2, keepdim=True) * outward
        gain = (_size(beyond) / _size(across).clamp_min(torch.finfo(torch.float32).tiny)).clamp_max(MAX_LEAF_GAIN)
        gain[:, 0] = 1
        return spectrum + self.share[:, None, None] * (gain[..., None] * across - beyond)


def leaves_of(
    grid: VoxelGrid,
    foliage_values: Float32[Tensor, "V O"],
    free: Float32[Tensor, " V"],
    axes: Float32[np.ndarray, "3 3"],
) -> Leaves:
    """Build the leaves from the foliage network's output.

    Args:
        grid: grid of the tree.
        foliage_values: output of the foliage network.
        free: 0 where the ground fixes a voxel, 1 elsewhere.
        axes: frame of the spectra.
    """
    # distance from the leaf's base below which a voxel's motion does not change; one voxel further it swings in full
    base_voxels = 0.5
    # vector from the base of each voxel's leaf to the voxel [voxels]; about 0 on wood
    arm = foliage_values[:, ARM].numpy() * ((int(np.ptp(grid.coords[:, 2])) + 1) / ARM_SCALE)
    length = np.linalg.norm(arm, axis=1)
    outward = arm @ axes.T / np.maximum(length, np.finfo(np.float32).tiny)[:, None]
    out = (length - base_voxels).clip(0, 1)
    return Leaves(
        base=torch.from_numpy(np.asarray(cKDTree(grid.coords).query(grid.coords - arm)[1], np.int64)),
        outward=torch.from_numpy(outward.astype(np.float32)),
        share=free * foliage_values[:, 0].clamp(0, 1) * torch.from_numpy(out.astype(np.float32)),
    )


def _size(vectors: Complex64[Tensor, "V K 3"]) -> Float32[Tensor, "V K"]:
    return squared_magnitude(vectors).sum(dim=2).sqrt()
