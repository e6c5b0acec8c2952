"""How hot loops are compiled and spread over the cores.

Kernels are plain numba functions that release the GIL and own some rows of the picture; threads call them. numba's own
`parallel=True` would bring OpenMP, which forbids the fork that a Celery worker makes, and thrice the compile time.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar, cast

import numba
import numpy as np

Kernel = TypeVar("Kernel", bound=Callable[..., object])

_BANDS = 12  # more than cores, so that an empty sky at one end leaves no core idle


def compiled(kernel: Kernel) -> Kernel:
    """Compile for this machine, keep the result on disk, run without the GIL."""
    return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy")(kernel))


def in_bands(kernel: Callable[..., object], num_rows: int, *arguments: object) -> None:
    """Call `kernel(first_row, end_row, *arguments)` on bands that cover all rows, on all cores.

    A kernel writes to its own rows only, so the result does not depend on the number of threads.
    """
    edges = np.linspace(0, num_rows, min(_BANDS, num_rows) + 1).astype(int).tolist()
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        calls = [pool.submit(kernel, first, end, *arguments) for first, end in pairwise(edges)]
        for call in calls:
            call.result()
