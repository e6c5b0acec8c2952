"""Noise with the spatial correlation of the motion, so that the network need not learn smoothness.

The noise is a sum of several fields: white at the nodes, smoothed along the stems, interpolated from coarser levels,
and one number for the whole tree. All have unit variance at every node; their shares are fitted per frequency to the
correlation of the training set's whitened spectra.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Int64
from scipy.sparse import csr_array, eye_array
from torch import Tensor

from dynamictree.sparse.level import Pyramid
from dynamictree.sparse.matrices import (
    SparseRows,
    link_matrices,
    neighbour_means,
    sparse_rows,
    unit_rows,
    upsample_matrix,
)

STEPS_ALONG = (1, 2, 4, 8)
NUM_SCALES = 2 + len(STEPS_ALONG) + 3
"""White at the nodes; over touching nodes; along the stems by STEPS_ALONG; one and two levels up; the whole tree."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseBasis:
    """Noise basis of one tree: matrices [W, n] with rows of unit length."""

    fields: tuple[SparseRows, ...]

    def draw(
        self, shares: Float32[Tensor, "J S"], generator: torch.Generator, *, channels: int
    ) -> Float32[Tensor, "W J C"]:
        """Draw noise of unit variance; `shares` are the fields' variances per frequency, with sum 1."""
        total: Tensor | None = None
        for field, share in zip(self.fields, shares.T, strict=True):
            white = torch.randn(field.num_columns, len(shares), channels, generator=generator)
            drawn = field.apply(white * share.sqrt()[:, None])
            total = drawn if total is None else total + drawn
        assert total is not None
        return total


def noise_basis(grids: Pyramid, links: Int64[Tensor, "L 2"]) -> NoiseBasis:
    """Build the noise basis of a tree, given at its nodes (see `coarsen_features`)."""
    return NoiseBasis(fields=tuple(sparse_rows(matrix) for matrix in field_matrices(grids, links)))


def field_matrices(grids: Pyramid, links: Int64[Tensor, "L 2"]) -> tuple[csr_array, ...]:
    """Return the matrix [W, n] of each field, finest first, with rows of unit length."""
    size = len(grids.levels[0])
    white = csr_array(eye_array(size, format="csr", dtype=np.float32))
    down, up = link_matrices(links, size)
    step = csr_array((white + down + up) / 3)
    along, walked = [], white
    for count in range(1, max(STEPS_ALONG) + 1):
        walked = csr_array(step @ walked)  # not by squares, as nodes that bear many have long rows
        if count in STEPS_ALONG:
            along.append(walked)
    coarser = [upsample_matrix(grids, depth, 0) for depth in (1, 2)]
    whole = csr_array(np.ones((size, 1), np.float32))
    return tuple(unit_rows(field) for field in (white, neighbour_means(grids.levels[0]), *along, *coarser, whole))
