"""Compilation of hot loops with numba, their distribution over the cores, and a one-thread limit for BLAS.

Kernels are plain numba functions that release the GIL and own some rows of their output; threads call them. numba's own
`parallel=True` would bring OpenMP, which forbids the fork that a Celery worker makes, and triple the compile time.
"""

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from functools import cache
from itertools import pairwise
from typing import TypeVar, cast

import numba
import numpy as np
from threadpoolctl import ThreadpoolController

Kernel = TypeVar("Kernel", bound=Callable[..., object])
Item = TypeVar("Item")
Result = TypeVar("Result")

_BANDS = 12  # more bands than cores, so that bands without work leave no core idle
_this_thread = threading.local()


def compiled(kernel: Kernel, fastmath: frozenset[str] = frozenset()) -> Kernel:
    """Compile for this machine, cache the result on disk where a folder is writable, release the GIL."""
    dispatcher = numba.njit(nogil=True, error_model="numpy", fastmath=set(fastmath))(kernel)
    with suppress(RuntimeError):  # without a folder, each process compiles anew
        dispatcher.enable_caching()
    return cast(Kernel, dispatcher)


def compiled_fused(kernel: Kernel) -> Kernel:
    """Compile like `compiled`; products and sums may be fused, and the sign of zero is ignored."""
    return compiled(kernel, frozenset({"contract", "nsz"}))


def compiled_reordered(kernel: Kernel) -> Kernel:
    """Compile like `compiled_fused`; sums may also be reordered, so that they vectorize."""
    return compiled(kernel, frozenset({"contract", "nsz", "reassoc"}))


def num_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def in_bands(kernel: Callable[..., object], num_rows: int, *arguments: object, rows_per_thread: int = 1) -> None:
    """Call `kernel(first_row, end_row, *arguments)` on bands that cover all rows, on all cores.

    A kernel writes to its own rows only, so the result does not depend on the number of threads. `rows_per_thread` is
    the number of rows that take as long as the start of a thread.
    """
    max_threads = min(num_cores(), max(num_rows // rows_per_thread, 1))
    if max_threads == 1 or getattr(_this_thread, "has_a_call", False):
        kernel(0, num_rows, *arguments)
        return
    num_bands = min(_BANDS, num_rows)
    bands = iter(list(pairwise(np.linspace(0, num_rows, num_bands + 1).astype(int).tolist())))

    def take_bands() -> None:
        for first, end in bands:
            kernel(first, end, *arguments)

    # The calling thread takes bands too: starting a thread costs a tenth of a fast kernel's time.
    others = min(max_threads, num_bands) - 1
    with ThreadPoolExecutor(others) as pool:
        calls = [pool.submit(take_bands) for _ in range(others)]
        take_bands()
        for call in calls:
            call.result()


def on_cores(call: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Map `call` over items on all cores, in order; kernels within a call stay on its thread.

    Many small pictures would otherwise start threads for four kernels each, in twelve bands.
    """

    def take_calls() -> None:
        _this_thread.has_a_call = True

    with ThreadPoolExecutor(num_cores(), initializer=take_calls) as pool:
        return list(pool.map(call, items))


def single_thread() -> AbstractContextManager[object]:
    """Limit BLAS to one thread within a context, so that sums have the same order on any machine."""
    context: AbstractContextManager[object] = _blas().limit(limits=1, user_api="blas")
    return context


@cache
def _blas() -> ThreadpoolController:
    """Return the controller of the BLAS that numpy has loaded."""
    return ThreadpoolController()
