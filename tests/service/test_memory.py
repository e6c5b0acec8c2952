import os
import subprocess
import sys
from pathlib import Path

import pytest

from jobs.settings import Settings
from service.local.serve import listen, plans

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


@pytest.mark.parametrize(("how", "least_mib", "most_mib"), [("served", -1, 8), ("left to glibc", 20, 50)])
def test_a_thread_returns_the_memory_of_its_answer(how: str, least_mib: float, most_mib: float, tmp_path: Path) -> None:
    with listen("127.0.0.1", 0) as listening:
        children = {plan.name: plan for plan in plans(Settings(state_dir=tmp_path), listening)}
    environment = children["api"].environment if how == "served" else os.environ
    command = [sys.executable, "-c", MEASURE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert least_mib < float(done.stdout) < most_mib
