"""Bound on the displacement of vertices, for mesh parts that the fit cannot place well."""

import numpy as np
from jaxtyping import Complex64, Float32

from dynamictree.devoxelize.nearest import nearest
from dynamictree.parallel import single_thread
from dynamictree.spectrum import synthesis
from dynamictree.voxel.grid import VoxelGrid

MOST_OVER_VOXELS = 1.2
"""Of the farthest that a voxel around a vertex moves: the farthest that the vertex may."""

_FRAMES_A_BIN = 14  # so many frames a period of the highest frequency miss a peak by 2.5 % at most
_POINTS_AT_ONCE = 1_000  # their frames stay in a core's cache
_AROUND = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], np.int32)


def limited(
    vertices: Float32[np.ndarray, "N 3"],
    motion: Complex64[np.ndarray, "N K 3"],
    grid: VoxelGrid,
    coefficients: Complex64[np.ndarray, "V K 3"],
) -> Complex64[np.ndarray, "N K 3"]:
    """Scale down the motion of vertices that move farther than `MOST_OVER_VOXELS` times the voxels around them.

    Around a vertex are its voxel and the 26 that touch it; of a vertex in no voxel, those around the nearest one.
    """
    own, most = farthest(coefficients), np.zeros(len(grid), np.float32)
    for step in _AROUND:
        rows = grid.rows_of(grid.coords + step)
        np.maximum(most, np.where(rows >= 0, own[rows], 0), out=most)
    rows = grid.rows_of(grid.coords_of(vertices))
    outside = np.flatnonzero(rows < 0)
    rows[outside] = nearest(grid, vertices[outside]).rows[:, 0]
    allowed, reached = np.float32(MOST_OVER_VOXELS) * most[rows], farthest(motion)
    too_far = np.flatnonzero(reached > allowed)
    if len(too_far) == 0:
        return motion
    bounded = motion.copy()
    bounded[too_far] *= (allowed[too_far] / reached[too_far])[:, None, None]
    return bounded


def farthest(motion: Complex64[np.ndarray, "M K 3"]) -> Float32[np.ndarray, " M"]:
    """Greatest distance from the rest position over the loop [m]."""
    result = np.empty(len(motion), np.float32)
    num_frequencies = motion.shape[1]
    num_frames = _FRAMES_A_BIN * num_frequencies
    turns = synthesis(num_frequencies, num_frames)
    with single_thread():  # so small products wait for more threads longer than they take
        for start in range(0, len(motion), _POINTS_AT_ONCE):
            some = slice(start, start + _POINTS_AT_ONCE)
            axes = np.ascontiguousarray(motion[some].transpose(2, 0, 1)).view(np.float32)  # [3, M, 2K]
            x, y, z = np.square(axes.reshape(-1, 2 * num_frequencies) @ turns).reshape(3, -1, num_frames)
            result[some] = np.sqrt((x + y + z).max(axis=1))
    return result
