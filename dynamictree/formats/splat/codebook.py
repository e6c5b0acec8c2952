"""Quantisation: a codebook of 256 numbers for all values, and a palette of rows for all rows."""

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

CODES = 256


def codes_of(values: Float32[np.ndarray, "G C"]) -> tuple[UInt8[np.ndarray, "G C"], Float64[np.ndarray, " 256"]]:
    """Return each value's code and a codebook of 256 ascending numbers; exact for at most 256 distinct values."""
    distinct = np.unique(values).astype(np.float64)
    if len(distinct) <= CODES:
        book = np.concatenate([distinct, np.full(CODES - len(distinct), distinct[-1])])
    else:
        book = _fitted(np.sort(values, axis=None).astype(np.float64))
    return np.searchsorted((book[1:] + book[:-1]) / 2, values).astype(np.uint8), book


def _fitted(ascending: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " 256"]:
    """Fit a codebook by 1D k-means, started from quantiles and from equal steps, which cover rare large values."""
    rounds = 20  # iterations of Lloyd's algorithm; later ones change the error by less than a hundredth
    even = np.linspace(ascending[0], ascending[-1], CODES // 2)
    book = np.sort(np.concatenate([even, np.quantile(ascending, np.linspace(0, 1, CODES // 2))]))
    sums = np.concatenate([[0.0], np.cumsum(ascending)])
    for _ in range(rounds):
        ends = np.searchsorted(ascending, (book[1:] + book[:-1]) / 2)
        edges = np.concatenate([[0], ends, [len(ascending)]])
        count = np.diff(edges)
        book = np.where(count > 0, np.diff(sums[edges]) / np.maximum(count, 1), book)
    result: Float64[np.ndarray, " 256"] = np.sort(book)
    return result


def palette_of(
    rows: Float32[np.ndarray, "G C"], most: int
) -> tuple[Float32[np.ndarray, "P C"], Int64[np.ndarray, " G"]]:
    """Return a palette of at most `most` rows and each row's entry, by median cut: means of equally full boxes.

    All boxes are halved at once, each at the median of the column that varies most; `most` is a power of two.
    """
    count = len(rows)
    if count <= most:
        return rows, np.arange(count)
    order, box = np.arange(count), np.zeros(count, np.int64)
    for _ in range(most.bit_length() - 1):
        starts = np.flatnonzero(np.diff(box, prepend=-1))
        widest = _widest(rows, order, starts)
        order = order[np.lexsort((rows[order, widest[box]], box))]
        sizes = np.diff(starts, append=count)
        place = np.arange(count) - np.repeat(starts, sizes)
        box = 2 * box + (place >= np.repeat(sizes, sizes) // 2)
    starts = np.flatnonzero(np.diff(box, prepend=-1))
    sums = np.add.reduceat(rows[order], starts, axis=0, dtype=np.float64)
    labels = np.empty(count, np.int64)
    labels[order] = box
    return (sums / np.diff(starts, append=count)[:, None]).astype(np.float32), labels


def _widest(
    rows: Float32[np.ndarray, "G C"], order: Int64[np.ndarray, " G"], starts: Int64[np.ndarray, " boxes"]
) -> Int64[np.ndarray, " boxes"]:
    """Return the column that varies most in each box."""
    count = np.diff(starts, append=len(order))
    spread = np.empty((rows.shape[1], len(starts)))
    for column in range(rows.shape[1]):
        values = rows[order, column].astype(np.float64)
        mean = np.add.reduceat(values, starts) / count
        spread[column] = np.add.reduceat(values * values, starts) / count - mean * mean
    result: Int64[np.ndarray, " boxes"] = spread.argmax(axis=0)
    return result
