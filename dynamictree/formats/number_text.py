"""Numbers in text, as in OBJ, STL, PLY and PCD files and in tables of points."""

import warnings
from typing import overload

import numpy as np
from jaxtyping import Float64, Int64


@overload
def numbers_of(text: bytes) -> Float64[np.ndarray, " n"] | None: ...
@overload
def numbers_of(text: bytes, dtype: type[np.int64]) -> Int64[np.ndarray, " n"] | None: ...
def numbers_of(text: bytes, dtype: type[np.generic] = np.float64) -> np.ndarray | None:
    """Parse the numbers of a text, separated by blanks or line ends; None if it contains anything else."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # numpy before 2.3 warns of other text
            return np.fromstring(text, dtype, sep=" ") if text.strip() else np.zeros(0, dtype)
    except (ValueError, DeprecationWarning):
        return None


def rows_of(text: bytes, num_columns: int) -> Float64[np.ndarray, "n columns"] | None:
    """Parse the numbers of a text as a table; None if it contains anything else or its last row is incomplete."""
    values = numbers_of(text)
    if values is None or len(values) % num_columns:
        return None
    table: Float64[np.ndarray, "n columns"] = values.reshape(-1, num_columns)
    return table
