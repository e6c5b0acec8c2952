"""Nearest-voxel interpolation, as the paper does it."""

import numpy as np
from jaxtyping import Float32
from scipy.spatial import cKDTree

from dynamictree.devoxelize.interpolation import VoxelInterpolation
from dynamictree.voxel.grid import VoxelGrid


def nearest(grid: VoxelGrid, points: Float32[np.ndarray, "N 3"]) -> VoxelInterpolation:
    """Give each point the value of the voxel that it lies in, or of the nearest one. Paper section 3.6.

    Neighbouring vertices in different voxels move apart: this tears faces, which `smooth` does not.
    """
    in_voxels = (points.astype(np.float64) - grid.origin_m) / grid.voxel_size_m
    rows = np.asarray(cKDTree(grid.coords + 0.5).query(in_voxels)[1])
    return VoxelInterpolation(
        rows=rows[:, None].astype(np.int32), weights=np.ones((len(points), 1), np.float32), num_voxels=len(grid)
    )
