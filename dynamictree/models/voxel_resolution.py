"""Conversion of voxels to the resolution of a model."""

import math

import numpy as np
import torch
from scipy.sparse import csr_array

from dynamictree.errors import InputError
from dynamictree.sparse.level import pyramid
from dynamictree.sparse.matrices import upsample_matrix
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.moments import coarse_moments
from dynamictree.voxel.voxelize import SurfaceVoxels


def halvings_between(grid: VoxelGrid, resolution: int, model: str) -> int:
    """Return the number of halvings from a grid's resolution to a given one.

    Raises:
        InputError: the grid is coarser, or not finer by a power of two.
    """
    ratio = grid.resolution / resolution
    if ratio < 1 or not math.log2(ratio).is_integer():
        allowed = f"{model} accepts {resolution}, {2 * resolution} and {4 * resolution}"
        raise InputError(f"the voxel grid has resolution {grid.resolution}; {allowed}; voxelise again")
    return int(math.log2(ratio))


def halvings_served(grid: VoxelGrid, resolution: int, model: str, *, max_voxels: int) -> int:
    """Return the number of halvings, with further ones until a dense tree has at most `max_voxels`.

    Raises:
        InputError: the grid is coarser, or not finer by a power of two.
    """
    halvings = halvings_between(grid, resolution, model)
    while len(grid) > max_voxels and len(np.unique(grid.coords >> halvings, axis=0)) > max_voxels:
        halvings += 1
    return halvings


def coarsened(voxels: SurfaceVoxels, halvings: int) -> tuple[SurfaceVoxels, csr_array | None]:
    """Return the tree on a coarser grid, and the matrix that interpolates values back; None for 0 halvings."""
    if halvings == 0:
        return voxels, None
    grid, factor = voxels.grid, 1 << halvings
    coarse = VoxelGrid.from_coords(
        grid.coords // factor,
        origin_m=grid.origin_m,
        voxel_size_m=grid.voxel_size_m * factor,
        resolution=grid.resolution // factor,
    )
    owner = coarse.rows_of(grid.coords // factor)
    normals = np.zeros((len(coarse), 3), np.float32)
    np.add.at(normals, owner, voxels.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
    moments = None if voxels.moments is None else coarse_moments(voxels.moments, grid, coarse, owner)
    # a pyramid's coarser rows are in ascending order of coordinates, as the coarse grid's are
    fine = pyramid(torch.from_numpy(grid.coords.astype(np.int64)), halvings + 1)
    return SurfaceVoxels(grid=coarse, normals=normals, moments=moments), upsample_matrix(fine, halvings, 0)
