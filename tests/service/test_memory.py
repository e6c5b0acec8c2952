import os
import subprocess
import sys

import pytest

MEASURE = """
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
import numpy as np, psutil

np.ones(2**20).sum()  # freed: glibc's threshold rises to 8 MiB
together = Barrier(8)

def answer(_):
    values = np.ones(5 * 2**17)  # 5 MiB
    together.wait()
    del values
    together.wait()

with ThreadPoolExecutor(8) as threads:
    before = psutil.Process().memory_full_info().uss
    list(threads.map(answer, range(8)))
    print((psutil.Process().memory_full_info().uss - before) / 2**20)
"""


AS_SERVED = {"MALLOC_MMAP_THRESHOLD_": "131072"}


@pytest.mark.parametrize(("added", "least_mib", "most_mib"), [(AS_SERVED, -1, 8), ({}, 20, 50)])
def test_a_thread_returns_the_memory_of_its_answer(added: dict[str, str], least_mib: float, most_mib: float) -> None:
    command = [sys.executable, "-c", MEASURE]
    done = subprocess.run(command, env=os.environ | added, capture_output=True, text=True, check=True)
    assert least_mib < float(done.stdout) < most_mib
