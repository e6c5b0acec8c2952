"""Sparse matrices between fine voxels and the coarser nodes of the diffusion.

They are built once per tree: `pool_matrix` (mean over a node's voxels) and `upsample_matrix` (back, smooth, and only
over touching voxels).
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from scipy.sparse import csr_array, diags_array, eye_array
from torch import Tensor
from torch.nn import functional

from dynamictree.sparse.level import Pyramid, SparseLevel

UPSAMPLE_STEPS = 2
"""Steps of diffusion over touching voxels that turn the nearest node's value into a smooth field."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseRows:
    """A sparse matrix [V, W] in the form that `embedding_bag` multiplies with."""

    columns: Int64[Tensor, " E"]
    starts: Int64[Tensor, " V"]
    weights: Float32[Tensor, " E"]
    num_columns: int

    def apply(self, values: Float[Tensor, "W ..."]) -> Float[Tensor, "V ..."]:
        """Multiply the matrix by values."""
        flat = values.reshape(self.num_columns, -1)
        product = functional.embedding_bag(
            self.columns, flat, self.starts, mode="sum", per_sample_weights=self.weights.to(flat.dtype)
        )
        return product.view(len(self.starts), *values.shape[1:])


def sparse_rows(matrix: csr_array) -> SparseRows:
    """Convert a scipy matrix to torch."""
    return SparseRows(
        columns=torch.from_numpy(matrix.indices.astype(np.int64)),
        starts=torch.from_numpy(matrix.indptr[:-1].astype(np.int64)),
        weights=torch.from_numpy(matrix.data.astype(np.float32)),
        num_columns=matrix.shape[1],
    )


def neighbour_means(level: SparseLevel) -> csr_array:
    """Return the matrix of means over each voxel and those of its 26 neighbours that are occupied."""
    first, second = (torch.cat([pair[side] for pair in level.pairs]).numpy() for side in (0, 1))
    own, shape = np.arange(len(level)), (len(level), len(level))
    rows, columns = np.concatenate([first, second, own]), np.concatenate([second, first, own])
    share = (1 / np.bincount(rows, minlength=len(level))).astype(np.float32)
    return csr_array((share[rows], (rows, columns)), shape=shape)


def link_matrices(links: Int64[Tensor, "L 2"], size: int) -> tuple[csr_array, csr_array]:
    """Return the matrices of means over the bearers of a row, and over the rows it bears; rows without any are zero."""
    rows, bearers = links.numpy().T
    down = csr_array((np.ones(len(rows), np.float32), (rows, bearers)), shape=(size, size))
    return _row_normalised(down), _row_normalised(csr_array(down.T))


def upsample_matrix(grids: Pyramid, coarse: int, fine: int, *, steps: int = UPSAMPLE_STEPS) -> csr_array:
    """Return [V_fine, V_coarse]: nearest interpolation, smoothed by `steps` at every level; rows sum to one."""
    matrix = csr_array(eye_array(len(grids.levels[coarse]), format="csr", dtype=np.float32))
    for depth in range(coarse - 1, fine - 1, -1):
        matrix = csr_array(matrix[grids.parents[depth].numpy()])
        smooth = neighbour_means(grids.levels[depth])
        for _ in range(steps):
            matrix = csr_array(smooth @ matrix)
    return matrix


def pool_matrix(grids: Pyramid, coarse: int, fine: int) -> csr_array:
    """Return [V_coarse, V_fine]: mean over the fine voxels of each coarse one."""
    ancestor = grids.rows_above(coarse, fine)
    ones = np.ones(len(ancestor), np.float32)
    shape = (len(grids.levels[coarse]), len(ancestor))
    return _row_normalised(csr_array((ones, (ancestor.numpy(), np.arange(len(ancestor)))), shape=shape))


def _row_normalised(matrix: csr_array) -> csr_array:
    sums = np.asarray(matrix.sum(axis=1)).ravel()
    return csr_array(diags_array((1 / np.where(sums > 0, sums, 1)).astype(np.float32)) @ matrix)
