"""Smooth interpolation that follows the connectivity of the mesh, used in place of the nearest voxel of the paper."""

from dataclasses import replace

import numpy as np
import scipy.sparse

from dynamictree.devoxelize.attachment import find_attachments
from dynamictree.devoxelize.interpolation import VoxelInterpolation
from dynamictree.devoxelize.nearest import nearest
from dynamictree.devoxelize.surface_fit import MAX_FACTORED, SMOOTHNESS, fit_surface
from dynamictree.mesh import Surface, edges_of, weld
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import grid_pieces, surface_average

MAX_VOXELS_PER_POINT = 8


def smooth(
    grid: VoxelGrid, mesh: Surface, *, smoothness: float = SMOOTHNESS, max_factored: int = MAX_FACTORED
) -> VoxelInterpolation:
    """Find the smoothest motion of the mesh whose mean in each voxel is the voxel's value, see `surface_fit.py`.

    Only connected surface counts: a twig that passes close by has no influence. `rows` and `weights` are the voxels
    that a vertex's faces and its neighbours' faces pass through, by area. Vertices at one position move as one.

    Args:
        grid: of this mesh, from `voxelize`.
        mesh: in its rest pose.
        smoothness: cost of an uneven motion relative to that of a mean that differs from the voxel's value.
        max_factored: unknowns of the fit; where there are more, a vertex gets the mean of its voxels by area.

    Raises:
        InputError: a voxel of the grid holds none of the mesh's surface.
    """
    still = mesh.still_vertices
    mesh, vertex = weld(mesh.moving_part)
    pieces = grid_pieces(mesh, grid)
    average, attachments = surface_average(mesh, grid, pieces), find_attachments(mesh, grid, pieces)
    shares = _rows_to_one(average.T.tocsr())  # [N, V]
    start, end = edges_of(mesh.faces).T
    pairs = np.concatenate([start, end]), np.concatenate([end, start])
    neighbours = scipy.sparse.coo_array((np.ones(len(pairs[0]), np.float32), pairs), shape=(mesh.num_vertices,) * 2)
    shares = _rows_to_one(shares + _rows_to_one(neighbours.tocsr()) @ shares)
    interpolation = _strongest(shares, MAX_VOXELS_PER_POINT)
    loose = np.flatnonzero(interpolation.weights.sum(axis=1) == 0)
    if len(loose):
        interpolation.rows[loose, 0] = nearest(grid, mesh.vertices[loose]).rows[:, 0]
        interpolation.weights[loose, 0] = 1
    return replace(
        interpolation,
        rows=interpolation.rows[vertex],
        weights=np.where(still[:, None], np.float32(0), interpolation.weights[vertex]),
        fit=fit_surface(mesh, grid, average, attachments, smoothness=smoothness, max_factored=max_factored),
        fitted=vertex,
        attachments=attachments,
        still=still if still.any() else None,
    )


def _rows_to_one(matrix: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Scale every row that is not empty to sum to 1."""
    total = np.asarray(matrix.sum(axis=1)).ravel()
    scaled: scipy.sparse.csr_array = matrix.multiply(1 / np.where(total > 0, total, 1)[:, None]).tocsr()
    return scaled


def _strongest(shares: scipy.sparse.csr_array, width: int) -> VoxelInterpolation:
    """Keep the largest weights of each row, scaled to sum to 1; rows that have fewer are filled with weight 0."""
    num_points, num_voxels = shares.shape
    point = np.repeat(np.arange(num_points), np.diff(shares.indptr))
    shares.sort_indices()
    order = np.lexsort((-shares.data, point))
    rank = np.arange(len(point)) - shares.indptr[point]  # in sorted order
    strongest = rank < width
    rows, weights = np.zeros((num_points, width), np.int32), np.zeros((num_points, width), np.float32)
    rows[point[strongest], rank[strongest]] = shares.indices[order][strongest]
    weights[point[strongest], rank[strongest]] = shares.data[order][strongest]
    total = weights.sum(axis=1, keepdims=True)
    weights /= np.where(total > 0, total, 1)
    return VoxelInterpolation(rows=rows, weights=weights, num_voxels=num_voxels)
