"""Masks of the Gaussians that may move: NumPy's `.npy`, one bool, or 0 or 1, per Gaussian in the cloud's order."""

import numpy as np
from jaxtyping import Bool

from dynamictree.errors import FormatError
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.gaussian.cloud import MAX_GAUSSIANS


def read_mask(stream: SeekableReader) -> Bool[np.ndarray, " G"]:
    """Read a mask.

    Raises:
        FormatError: no `.npy` file, too large, or not one row of bools or of 0 and 1.
    """
    max_header_bytes = 4096
    size = remaining_bytes(stream)
    if size > MAX_GAUSSIANS + max_header_bytes:
        raise FormatError(f"the mask is {size:,} bytes; a byte a Gaussian, at most {MAX_GAUSSIANS:,}, is allowed")
    try:
        mask = np.lib.format.read_array(stream, allow_pickle=False, max_header_size=max_header_bytes)
    except (ValueError, EOFError, MemoryError) as error:
        raise FormatError(f"the mask is no .npy file: {str(error)[:200]}") from error
    if mask.dtype.name not in ("bool", "uint8") or mask.ndim != 1 or (mask.size and mask.max() > 1):
        value = f"{mask.dtype.name} {list(mask.shape)}"
        raise FormatError(f"the mask is {value}; one row of bool, or of uint8 that are 0 or 1, is allowed")
    result: Bool[np.ndarray, " G"] = mask.astype(np.bool_)
    return result
