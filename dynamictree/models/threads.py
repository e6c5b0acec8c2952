"""Parallel inference: independent calls run on separate threads, each with one torch thread.

torch's own threads wait for one another in every operation. The products are small, and on a busy machine two such
threads were measured 10 times slower than one. Calls that are independent need no such barrier, and their results do
not depend on the number of threads.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

from dynamictree.parallel import num_cores

Result = TypeVar("Result")


def run_on_cores(calls: Iterable[Callable[[], Result]]) -> list[Result]:
    """Run independent calls without gradients; return results in order, or raise the first exception."""

    def without_gradients(call: Callable[[], Result]) -> Result:
        with torch.no_grad():  # a setting of each thread
            return call()

    with ThreadPoolExecutor(num_cores()) as pool:
        return list(pool.map(without_gradients, calls))


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit each call into torch to the thread that makes it."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
