"""Rows to columns and back in vectors, against the loops that they stand for."""

import numba
import numpy as np
import pytest

from dynamictree.gaussian.vector_rows import (
    LANES,
    gather_columns,
    interleave3,
    interleave4,
    scatter_columns,
    stream3,
    stream4,
)

STRIDE = 40


def at_cache_line(count: int) -> np.ndarray:
    raw = np.zeros(count + 16, np.float32)
    start = -raw.ctypes.data % 64 // 4
    return raw[start : start + count]


def test_gathered_rows_are_columns(rng: np.random.Generator) -> None:
    table, rows = rng.normal(size=(50, LANES)).astype(np.float32), rng.integers(0, 50, 24).astype(np.int32)
    columns = np.zeros(LANES * STRIDE, np.float32)
    numba.njit(lambda t, r, c: gather_columns(t, r, 5, c, 3, STRIDE))(table, rows, columns)
    np.testing.assert_array_equal(columns.reshape(LANES, STRIDE)[:, 3 : 3 + LANES], table[rows[5 : 5 + LANES]].T)
    assert np.count_nonzero(columns) == LANES * LANES


def test_scattered_columns_are_rows(rng: np.random.Generator) -> None:
    columns, table = rng.normal(size=LANES * STRIDE).astype(np.float32), np.zeros((40, LANES), np.float32)
    numba.njit(lambda c, t: scatter_columns(c, 3, STRIDE, t, 7))(columns, table)
    np.testing.assert_array_equal(table[7 : 7 + LANES], columns.reshape(LANES, STRIDE)[:, 3 : 3 + LANES].T)
    assert np.count_nonzero(table) == LANES * LANES


@pytest.mark.parametrize(
    ("width", "interleave"), [(3, interleave3), (4, interleave4), (3, stream3), (4, stream4)], ids=str
)
def test_columns_are_interleaved(rng: np.random.Generator, width: int, interleave: object) -> None:
    columns, flat = rng.normal(size=4 * STRIDE).astype(np.float32), at_cache_line(width * 32)
    numba.njit(lambda c, f: interleave(c, 3, STRIDE, f, width * LANES))(columns, flat)
    expected = columns.reshape(4, STRIDE)[:width, 3 : 3 + LANES].T
    np.testing.assert_array_equal(flat.reshape(-1, width)[LANES:], expected)
    assert np.count_nonzero(flat) == width * LANES
