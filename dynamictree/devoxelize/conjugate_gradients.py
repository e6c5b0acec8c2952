"""Conjugate gradients for many right-hand sides at once, preconditioned by the blocks of vertices, on all cores.

Saad, Iterative Methods for Sparse Linear Systems, algorithm 9.1. Columns have steps of their own, so bands of WIDTH
columns are solved on threads of their own; a band's vectors stay in a core's cache.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import no_type_check

import numpy as np
import scipy.sparse
from jaxtyping import Float32, Float64, Int32

from dynamictree.parallel import compiled_reordered, num_cores

WIDTH = 16
"""Columns of one band: a cache line of single precision."""
_AXES = 3
_BLOCK = 64  # rows whose products are summed in single precision


def conjugate_gradients(
    system: scipy.sparse.csr_array,
    right: Float32[np.ndarray, "M D"],
    start: Float32[np.ndarray, "M D"],
    steps: int,
) -> Float32[np.ndarray, "M D"]:
    """Take `steps` steps from `start` towards the solution of `system` @ x = `right`.

    The result does not depend on the number of cores.

    Args:
        system: symmetric and positive definite, [3n, 3n]: three rows for each vertex.
        right: right-hand sides.
        start: where to start from.
        steps: number of steps.
    """
    blocks = system.tobsr((_AXES, _AXES))
    matrix = blocks.indptr, blocks.indices, blocks.data.ravel()
    inverse = np.linalg.inv(_diagonal_blocks(blocks)).astype(np.float32).ravel()
    num_rows, num_columns = right.shape

    def solve(first: int) -> Float32[np.ndarray, "M w"]:
        width = min(WIDTH, num_columns - first)
        residual, solution = (np.zeros((num_rows, WIDTH), np.float32) for _ in range(2))
        residual[:, :width], solution[:, :width] = right[:, first : first + width], start[:, first : first + width]
        _solve_band(*matrix, inverse, residual.ravel(), solution.ravel(), steps)
        return solution[:, :width]

    with ThreadPoolExecutor(num_cores()) as pool:
        return np.concatenate(list(pool.map(solve, range(0, num_columns, WIDTH))), axis=1)


def _diagonal_blocks(blocks: scipy.sparse.bsr_array) -> Float64[np.ndarray, "n 3 3"]:
    """What each vertex's displacement does to its own force: edges are stiff along, and soft across."""
    vertex = np.repeat(np.arange(len(blocks.indptr) - 1), np.diff(blocks.indptr))
    diagonal: Float64[np.ndarray, "n 3 3"] = blocks.data[vertex == blocks.indices].astype(np.float64)
    return diagonal


@compiled_reordered
@no_type_check  # numba compiles no checked function
def _solve_band(
    starts: Int32[np.ndarray, " n_1"],
    neighbours: Int32[np.ndarray, " B"],
    blocks: Float32[np.ndarray, " 9B"],
    inverse: Float32[np.ndarray, " 3M"],
    residual: Float32[np.ndarray, " 16M"],
    solution: Float32[np.ndarray, " 16M"],
    steps: int,
) -> None:
    """Solve in place; `residual` is the right-hand side at first. Flat arrays, which the compiler vectorizes."""
    image, direction = np.empty_like(solution), np.empty_like(solution)
    step, product, former = np.zeros(WIDTH, np.float32), np.zeros(WIDTH), np.zeros(WIDTH)
    _multiply(starts, neighbours, blocks, solution, image)
    _add(np.full(WIDTH, np.float32(-1)), image, residual)
    _precondition(inverse, residual, direction)
    _dots(residual, direction, product)
    for _ in range(steps):
        _multiply(starts, neighbours, blocks, direction, image)
        _dots(direction, image, former)
        _ratio(product, former, step)
        _add(step, direction, solution)
        _add(-step, image, residual)
        _precondition(inverse, residual, image)
        former[:] = product
        _dots(residual, image, product)
        _ratio(product, former, step)
        _scale_and_add(step, image, direction)


@compiled_reordered
@no_type_check  # numba compiles no checked function
def _multiply(
    starts: Int32[np.ndarray, " n_1"],
    neighbours: Int32[np.ndarray, " B"],
    blocks: Float32[np.ndarray, " 9B"],
    values: Float32[np.ndarray, " 16M"],
    image: Float32[np.ndarray, " 16M"],
) -> None:
    """Write the matrix times `values` into `image`. Scalars and unsigned indices, which vectorize: 5 times as fast."""
    for vertex in range(len(starts) - 1):
        own = np.uint64(_AXES * WIDTH * vertex)
        for column in range(_AXES * WIDTH):
            image[own + np.uint64(column)] = np.float32(0)
        for entry in range(starts[vertex], starts[vertex + 1]):
            other, at = np.uint64(_AXES * WIDTH * neighbours[entry]), 9 * entry
            xx, xy, xz = blocks[at], blocks[at + 1], blocks[at + 2]
            yx, yy, yz = blocks[at + 3], blocks[at + 4], blocks[at + 5]
            zx, zy, zz = blocks[at + 6], blocks[at + 7], blocks[at + 8]
            for column in range(WIDTH):
                lane = np.uint64(column)
                x = values[other + lane]
                y = values[other + np.uint64(WIDTH) + lane]
                z = values[other + np.uint64(2 * WIDTH) + lane]
                image[own + lane] += xx * x + xy * y + xz * z
                image[own + np.uint64(WIDTH) + lane] += yx * x + yy * y + yz * z
                image[own + np.uint64(2 * WIDTH) + lane] += zx * x + zy * y + zz * z


@compiled_reordered
@no_type_check  # numba compiles no checked function
def _dots(
    one: Float32[np.ndarray, " 16M"], other: Float32[np.ndarray, " 16M"], products: Float64[np.ndarray, " 16"]
) -> None:
    """Write the scalar product of each column, summed in double precision over blocks of rows."""
    products[:] = 0
    block = np.zeros(WIDTH, np.float32)
    for first in range(0, len(one), WIDTH * _BLOCK):
        block[:] = 0
        for place in range(first, min(first + WIDTH * _BLOCK, len(one)), WIDTH):
            for column in range(WIDTH):
                lane = np.uint64(column)
                block[lane] += one[np.uint64(place) + lane] * other[np.uint64(place) + lane]
        for column in range(WIDTH):
            products[column] += block[column]


@compiled_reordered
@no_type_check  # numba compiles no checked function
def _add(
    factor: Float32[np.ndarray, " 16"], values: Float32[np.ndarray, " 16M"], total: Float32[np.ndarray, " 16M"]
) -> None:
    """Add each column of `values` times its factor to `total`."""
    for row in range(0, len(values), WIDTH):
        for column in range(WIDTH):
            lane = np.uint64(column)
            total[np.uint64(row) + lane] += factor[lane] * values[np.uint64(row) + lane]


@compiled_reordered
@no_type_check  # numba compiles no checked function
def _scale_and_add(
    factor: Float32[np.ndarray, " 16"], values: Float32[np.ndarray, " 16M"], total: Float32[np.ndarray, " 16M"]
) -> None:
    """Multiply each column of `total` by its factor, then add `values`."""
    for row in range(0, len(values), WIDTH):
        for column in range(WIDTH):
            lane = np.uint64(column)
            place = np.uint64(row) + lane
            total[place] = factor[lane] * total[place] + values[place]


@compiled_reordered
@no_type_check  # numba compiles no checked function
def _precondition(
    inverse: Float32[np.ndarray, " 3M"], values: Float32[np.ndarray, " 16M"], scaled: Float32[np.ndarray, " 16M"]
) -> None:
    """Write the rows of each vertex times its block of `inverse`."""
    for vertex in range(len(inverse) // 9):
        own, at = np.uint64(_AXES * WIDTH * vertex), 9 * vertex
        xx, xy, xz = inverse[at], inverse[at + 1], inverse[at + 2]
        yx, yy, yz = inverse[at + 3], inverse[at + 4], inverse[at + 5]
        zx, zy, zz = inverse[at + 6], inverse[at + 7], inverse[at + 8]
        for column in range(WIDTH):
            lane = own + np.uint64(column)
            x, y, z = values[lane], values[lane + np.uint64(WIDTH)], values[lane + np.uint64(2 * WIDTH)]
            scaled[lane] = xx * x + xy * y + xz * z
            scaled[lane + np.uint64(WIDTH)] = yx * x + yy * y + yz * z
            scaled[lane + np.uint64(2 * WIDTH)] = zx * x + zy * y + zz * z


@compiled_reordered
@no_type_check  # numba compiles no checked function
def _ratio(
    above: Float64[np.ndarray, " 16"], below: Float64[np.ndarray, " 16"], ratio: Float32[np.ndarray, " 16"]
) -> None:
    """Write quotients, 0 where nothing is left to divide by."""
    for column in range(WIDTH):
        ratio[column] = np.float32(above[column] / below[column]) if below[column] > 0 else np.float32(0)
