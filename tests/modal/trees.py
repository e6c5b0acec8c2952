"""Small trees of voxels with known branches."""

import numpy as np

from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid

VOXEL_M = 0.1


def fork(num_frequencies: int = 8, *, fineness: int = 1) -> tuple[SparseVoxelSpectrum, dict[str, np.ndarray]]:
    """A stem of 2 m with a branch of 1.5 m to either side, three voxels wide; branches sway out of step.

    With it the rows along the middle of each part, from the root outward. Voxels are `VOXEL_M / fineness` wide.
    """
    voxel_m, middle_x, top = VOXEL_M / fineness, 25 * fineness, 20 * fineness - 1
    stem = np.array([(middle_x, 26, z) for z in range(top + 1)], np.int32)
    outward = range(1, 15 * fineness + 1)
    right = np.array([(middle_x + x, 26, top + x // 2) for x in outward], np.int32)
    left = np.array([(middle_x - x, 26, top + x // 2) for x in outward], np.int32)
    middle = np.concatenate([stem, right, left])
    coords = np.concatenate([middle + np.array([0, y, 0]) for y in (-1, 0, 1)]).astype(np.int32)
    resolution = 64 * fineness
    grid = VoxelGrid.from_coords(coords, origin_m=(0.0, 0.0, 0.0), voxel_size_m=voxel_m, resolution=resolution)
    parts = {"stem": grid.rows_of(stem), "right": grid.rows_of(right), "left": grid.rows_of(left)}

    rng = np.random.default_rng(3)
    along_y = np.array([0.0, 1.0, 0.0])
    out = (grid.coords[:, 0] - middle_x) * voxel_m  # from the stem, to the right
    height = np.where(out == 0, grid.coords[:, 2] + 1, top + 1) * voxel_m
    coefficients = np.zeros((len(grid), num_frequencies, 3), np.complex128)
    for k in range(1, num_frequencies):
        lean, *flutter = np.exp(2j * np.pi * rng.random(3)) * [0.02 / k, 0.04, 0.04]
        sway = lean * height**2 + np.where(out > 0, flutter[0], flutter[1]) * out**2
        coefficients[:, k] = sway[:, None] * along_y
    return SparseVoxelSpectrum(grid=grid, coefficients=coefficients.astype(np.complex64)), parts
