"""Compilation of hot loops with numba, their distribution over the cores, and a one-thread limit for BLAS.

Kernels are plain numba functions that release the GIL and own some rows of their output; threads call them. numba's own
`parallel=True` would bring OpenMP, which forbids the fork that a Celery worker makes, and triple the compile time.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import cache
from itertools import pairwise
from typing import TypeVar, cast

import numba
import numpy as np
from threadpoolctl import ThreadpoolController

Kernel = TypeVar("Kernel", bound=Callable[..., object])

_BANDS = 12  # more than cores, so that an empty sky at one end leaves no core idle


def compiled(kernel: Kernel) -> Kernel:
    """Compile for this machine, cache the result on disk, release the GIL."""
    return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy")(kernel))


def compiled_fused(kernel: Kernel) -> Kernel:
    """As `compiled`; products and sums may be fused, and the sign of zero is ignored."""
    fused = {"contract", "nsz"}
    return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=fused)(kernel))


def compiled_reordered(kernel: Kernel) -> Kernel:
    """As `compiled_fused`; sums may also be reordered, so that they vectorize."""
    reordered = {"contract", "nsz", "reassoc"}
    return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=reordered)(kernel))


def num_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def in_bands(kernel: Callable[..., object], num_rows: int, *arguments: object) -> None:
    """Call `kernel(first_row, end_row, *arguments)` on bands that cover all rows, on all cores.

    A kernel writes to its own rows only, so the result does not depend on the number of threads.
    """
    edges = np.linspace(0, num_rows, min(_BANDS, num_rows) + 1).astype(int).tolist()
    with ThreadPoolExecutor(num_cores()) as pool:
        calls = [pool.submit(kernel, first, end, *arguments) for first, end in pairwise(edges)]
        for call in calls:
            call.result()


def single_thread() -> AbstractContextManager[object]:
    """Context in which BLAS runs on the calling thread: sums in one order on any machine."""
    context: AbstractContextManager[object] = _blas().limit(limits=1, user_api="blas")
    return context


@cache
def _blas() -> ThreadpoolController:
    """The BLAS that numpy has loaded."""
    return ThreadpoolController()
