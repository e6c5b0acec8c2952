"""Parallel inference: independent calls run on separate threads, each with one torch thread, or on a GPU in turn.

torch's own threads wait for one another in every operation. The products are small, and on a busy machine two such
threads were measured 10 times slower than one. Calls that are independent need no such barrier, and their results do
not depend on the number of threads.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from dynamictree.parallel import num_cores, single_thread

Result = TypeVar("Result")
CPU = torch.device("cpu")


def best_device() -> torch.device:
    """Return the GPU if there is one, else the CPU."""
    return torch.device("cuda") if torch.cuda.is_available() else CPU


def to_device(device: torch.device, given: Any) -> Any:
    """Move a tensor to a device, or all tensors in a tuple or a dataclass."""
    if isinstance(given, tuple):
        return tuple(to_device(device, each) for each in given)
    if is_dataclass(given) and not isinstance(given, type):
        return replace(given, **{field.name: to_device(device, getattr(given, field.name)) for field in fields(given)})
    return given.to(device) if isinstance(given, Tensor) else given


def run_on_cores(calls: Iterable[Callable[[], Result]], device: torch.device = CPU) -> list[Result]:
    """Run independent calls without gradients; return results in order, or raise the first exception."""

    def without_gradients(call: Callable[[], Result]) -> Result:
        with torch.no_grad():  # the setting is per thread
            return call()

    if device.type != "cpu":
        return [without_gradients(call) for call in calls]
    with ThreadPoolExecutor(num_cores()) as pool:
        return list(pool.map(without_gradients, calls))


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit torch and BLAS to the calling thread within a context."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with single_thread():
            yield
    finally:
        torch.set_num_threads(before)
