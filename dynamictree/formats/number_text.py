"""Numbers in text, as OBJ, STL, PLY, PCD and tables of points have them."""

import warnings
from typing import overload

import numpy as np
from jaxtyping import Float64, Int64


@overload
def numbers_of(text: bytes) -> Float64[np.ndarray, " n"] | None: ...
@overload
def numbers_of(text: bytes, dtype: type[np.int64]) -> Int64[np.ndarray, " n"] | None: ...
def numbers_of(text: bytes, dtype: type[np.generic] = np.float64) -> np.ndarray | None:
    """All numbers of a text, with blanks or line ends between them; None where it has something else."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # as numpy before 2.3 says that it stopped
            return np.fromstring(text, dtype, sep=" ") if text.strip() else np.zeros(0, dtype)
    except (ValueError, DeprecationWarning):
        return None


def rows_of(text: bytes, num_columns: int) -> Float64[np.ndarray, "n columns"] | None:
    """The numbers of a text as a table; None where it has something else, or does not fill the last row."""
    values = numbers_of(text)
    if values is None or len(values) % num_columns:
        return None
    table: Float64[np.ndarray, "n columns"] = values.reshape(-1, num_columns)
    return table
