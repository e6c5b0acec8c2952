"""A job that needs more memory than there is fails; its worker is not killed for it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from jobs.settings import GIB, MIB
from worker.tasks import available_bytes, is_allocation_failure

ROOT = Path(__file__).parents[2]

PROGRAM = """
import sys
import numpy as np
from jobs.settings import Settings
from worker.tasks import limit_memory

for allowed in sys.argv[1:]:
    limit_memory(Settings(job_memory_bytes=int(allowed)))
    memory = np.ones(64 * 2**20, np.uint8)
    try:
        np.empty(2 * 2**30, np.uint8)
    except MemoryError:
        print(allowed)
"""


def test_an_allocation_beyond_the_limit_raises() -> None:
    program = [sys.executable, "-c", PROGRAM, str(4 * GIB), str(1 * GIB)]
    done = subprocess.run(program, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == [str(1 * GIB)]


FREED = """
import os
from tests.faults.soak import anonymous_bytes
from dynamictree.memory import return_freed_memory

before = anonymous_bytes(os.getpid())
blocks = [b"x" * 60_000 for _ in range(3000)]
last = b"x" * 60_001  # allocated above them all, so that the heap does not shrink by itself
del blocks
return_freed_memory()
print((anonymous_bytes(os.getpid()) - before) / 2**20)
"""


def test_what_was_freed_is_returned_to_the_system() -> None:
    program, environment = [sys.executable, "-c", FREED], os.environ | {"MALLOC_ARENA_MAX": "1"}
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=True, timeout=120, cwd=ROOT)
    assert float(done.stdout) < 20  # 172 MiB were allocated


@pytest.mark.parametrize("name", ["memory.max", "memory/memory.limit_in_bytes"])
def test_a_container_has_what_its_group_allows(tmp_path: Path, name: str) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(f"{512 * MIB}\n")
    assert available_bytes(tmp_path) == 512 * MIB


def test_a_group_without_a_limit_has_the_machine(tmp_path: Path) -> None:
    (tmp_path / "memory.max").write_text("max\n")
    assert available_bytes(tmp_path) == os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def test_pytorch_says_it_in_its_own_words() -> None:
    import torch

    with pytest.raises(RuntimeError) as caught:
        torch.ones(2**50)
    assert is_allocation_failure(caught.value)
    assert not is_allocation_failure(RuntimeError("shape '[2]' is invalid"))
