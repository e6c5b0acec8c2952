"""One thread for matrix products: sums in one order on any machine, and no waiting for a core that is busy."""

from contextlib import AbstractContextManager

import numpy as np
from threadpoolctl import ThreadpoolController

assert np is not None  # its BLAS must be loaded before it can be found
_BLAS = ThreadpoolController()


def single_thread() -> AbstractContextManager[object]:
    """Within it, BLAS runs on the calling thread."""
    context: AbstractContextManager[object] = _BLAS.limit(limits=1, user_api="blas")
    return context
