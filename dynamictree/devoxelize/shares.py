"""The voxels that each vertex of a mesh depends on, along the connectivity of the mesh."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float32, Int32

from dynamictree.devoxelize.attachment import Attachments, find_attachments
from dynamictree.devoxelize.nearest import nearest_rows
from dynamictree.mesh import Surface, edges_of, weld
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import grid_pieces, surface_average

MAX_VOXELS_PER_POINT = 8


@dataclass(frozen=True, kw_only=True)
class VoxelShares:
    """Weights from V voxels to the N vertices of a mesh: not negative, of sum 1, or all 0 for what stands still."""

    rows: Int32[np.ndarray, "N M"]  # into the grid's coords
    weights: Float32[np.ndarray, "N M"]
    welded: Int32[np.ndarray, " N"]  # of the welded mesh's vertices the one that each is
    attachments: Attachments  # of the welded mesh

    def mean(self, values: Float32[np.ndarray, "V D"]) -> Float32[np.ndarray, "N D"]:
        """The weighted mean of values at each vertex' voxels."""
        num_points, width = self.rows.shape
        ends = np.arange(0, num_points * width + 1, width)
        matrix = scipy.sparse.csr_array(
            (self.weights.ravel(), self.rows.ravel(), ends), shape=(num_points, len(values))
        )
        return np.asarray(matrix @ values)


def voxel_shares(grid: VoxelGrid, mesh: Surface) -> VoxelShares:
    """Find the voxels that a vertex's faces and its neighbours' faces pass through, and their shares by area.

    Only connected surface counts: a twig that passes close by has no influence. Vertices at one position have the same.

    Args:
        grid: of this mesh, from `voxelize`.
        mesh: in its rest pose.

    Raises:
        InputError: a voxel of the grid holds none of the mesh's surface.
    """
    still = mesh.still_vertices
    mesh, vertex = weld(mesh.moving_part)
    pieces = grid_pieces(mesh, grid)
    shares = _rows_to_one(surface_average(mesh, grid, pieces).T.tocsr())  # [N, V]
    start, end = edges_of(mesh.faces).T
    pairs = np.concatenate([start, end]), np.concatenate([end, start])
    neighbours = scipy.sparse.coo_array((np.ones(len(pairs[0]), np.float32), pairs), shape=(mesh.num_vertices,) * 2)
    rows, weights = _strongest(_rows_to_one(shares + _rows_to_one(neighbours.tocsr()) @ shares))
    loose = np.flatnonzero(weights.sum(axis=1) == 0)
    if len(loose):
        rows[loose, 0], weights[loose, 0] = nearest_rows(grid, mesh.vertices[loose]), 1
    return VoxelShares(
        rows=rows[vertex],
        weights=np.where(still[:, None], np.float32(0), weights[vertex]),
        welded=vertex,
        attachments=find_attachments(mesh, grid, pieces),
    )


def _rows_to_one(matrix: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Scale every row that is not empty to sum to 1."""
    total = np.asarray(matrix.sum(axis=1)).ravel()
    scaled: scipy.sparse.csr_array = matrix.multiply(1 / np.where(total > 0, total, 1)[:, None]).tocsr()
    return scaled


def _strongest(shares: scipy.sparse.csr_array) -> tuple[Int32[np.ndarray, "N M"], Float32[np.ndarray, "N M"]]:
    """Keep the largest weights of each row, scaled to sum to 1; rows that have fewer are filled with weight 0."""
    num_points = shares.shape[0]
    point = np.repeat(np.arange(num_points), np.diff(shares.indptr))
    shares.sort_indices()
    order = np.lexsort((-shares.data, point))
    rank = np.arange(len(point)) - shares.indptr[point]  # in sorted order
    strongest = rank < MAX_VOXELS_PER_POINT
    shape = (num_points, MAX_VOXELS_PER_POINT)
    rows, weights = np.zeros(shape, np.int32), np.zeros(shape, np.float32)
    rows[point[strongest], rank[strongest]] = shares.indices[order][strongest]
    weights[point[strongest], rank[strongest]] = shares.data[order][strongest]
    total = weights.sum(axis=1, keepdims=True)
    return rows, weights / np.where(total > 0, total, 1)
