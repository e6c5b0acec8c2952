"""Sparse symmetric positive definite systems: factored once, solved for many right-hand sides on all cores.

A = P (I + L) D (I + L)ᵀ Pᵀ with L strictly lower triangular. SuperLU finds the factors; its solve runs on one core,
so bands of WIDTH columns are solved here, on threads of their own. The factors are plain arrays, which can be stored.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float64, Int32

from dynamictree.parallel import compiled_fused, num_cores

WIDTH = 16
"""Columns of one band: two cache lines of double precision."""


@dataclass(frozen=True, kw_only=True)
class SymmetricFactor:
    """The factors of a system, columns of L one after another. Built by `factored`."""

    order: Int32[np.ndarray, " n"]  # of each row of the system, its row in the factors
    ends: Int32[np.ndarray, " n"]  # of the columns of L, in `rows` and `values`
    rows: Int32[np.ndarray, " nnz"]
    values: Float64[np.ndarray, " nnz"]
    inverse: Float64[np.ndarray, " n"]  # of D

    def solve(self, right: Float64[np.ndarray, "n D"]) -> Float64[np.ndarray, "n D"]:
        """The solution x of A x = `right`. The result does not depend on the number of cores."""
        num_columns = right.shape[1]
        solution = np.empty(right.shape)

        def solve_band(first: int) -> None:
            width = min(WIDTH, num_columns - first)
            band = np.zeros((len(right), WIDTH))
            band[self.order, :width] = right[:, first : first + width]
            _solve_band(self.ends, self.rows, self.values, self.inverse, band.ravel())
            solution[:, first : first + width] = band[self.order, :width]

        with ThreadPoolExecutor(num_cores()) as pool:
            list(pool.map(solve_band, range(0, num_columns, WIDTH)))
        return solution


def factored(system: scipy.sparse.csc_array) -> SymmetricFactor:
    """Factor a symmetric positive definite system [n, n]: no pivoting, and an ordering for Cholesky's pattern."""
    factors = scipy.sparse.linalg.splu(
        system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    assert np.array_equal(factors.perm_r, factors.perm_c)
    lower = scipy.sparse.tril(factors.L, -1).tocsc()
    lower.sort_indices()
    return SymmetricFactor(
        order=factors.perm_r.astype(np.int32),
        ends=lower.indptr[1:].astype(np.int32),
        rows=lower.indices.astype(np.int32),
        values=lower.data,
        inverse=1 / factors.U.diagonal(),
    )


@compiled_fused
@no_type_check  # numba compiles no checked function
def _solve_band(
    ends: Int32[np.ndarray, " n"],
    rows: Int32[np.ndarray, " nnz"],
    values: Float64[np.ndarray, " nnz"],
    inverse: Float64[np.ndarray, " n"],
    band: Float64[np.ndarray, " 16n"],
) -> None:
    """Solve in place, column after column of L and back. Unsigned indices, which vectorize."""
    start = 0
    for column in range(len(ends)):
        own = np.uint64(WIDTH * column)
        for entry in range(start, ends[column]):
            value, other = values[entry], np.uint64(WIDTH * rows[entry])
            for k in range(WIDTH):
                lane = np.uint64(k)
                band[other + lane] -= value * band[own + lane]
        start = ends[column]
    for column in range(len(ends) - 1, -1, -1):
        own = np.uint64(WIDTH * column)
        for k in range(WIDTH):
            band[own + np.uint64(k)] *= inverse[column]
        for entry in range(ends[column - 1] if column else 0, ends[column]):
            value, other = values[entry], np.uint64(WIDTH * rows[entry])
            for k in range(WIDTH):
                lane = np.uint64(k)
                band[own + lane] -= value * band[other + lane]
