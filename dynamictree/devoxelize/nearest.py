"""Nearest voxel of each point: the devoxelization of the paper."""

import numpy as np
from jaxtyping import Float32, Int32
from scipy.spatial import cKDTree

from dynamictree.voxel.grid import VoxelGrid


def nearest_rows(grid: VoxelGrid, points: Float32[np.ndarray, "N 3"]) -> Int32[np.ndarray, " N"]:
    """Return the row of the voxel at or nearest to each point. Paper section 3.6.

    Neighbouring vertices in different voxels move apart, which tears faces; a rig does not.
    """
    in_voxels = (points.astype(np.float64) - grid.origin_m) / grid.voxel_size_m
    return np.asarray(cKDTree(grid.coords + 0.5).query(in_voxels)[1], np.int32)
