"""Fixtures that every package's tests may use."""

import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

gc.disable()  # imports make millions of objects and next to no garbage
settings.register_profile("any-machine", deadline=None)  # an example may be slow on a busy one
settings.load_profile("any-machine")


def pytest_collection_finish() -> None:
    """Leave out of every later garbage collection what was imported."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Limit torch to one thread, also after a command that set its own number: two are slower in small products."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture(scope="session")
def samples() -> Path:
    """The folder of real sample files, laid out as the README tells; skipped where DYNAMICTREE_SAMPLES is unset."""
    folder = os.environ.get("DYNAMICTREE_SAMPLES")
    if not folder:
        pytest.skip("DYNAMICTREE_SAMPLES is unset: it names the folder of real sample files")
    return Path(folder)


@pytest.fixture(scope="session")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small tree as a GLB."""
    from dynamictree.formats.gltf.writer import write_glb
    from lab.dataset.sample import make_sample

    path = tmp_path_factory.mktemp("trees") / "sapling.glb"
    with path.open("wb") as stream:
        write_glb(make_sample(3, "sapling").mesh, stream)
    return path


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that is the same in every run."""
    return np.random.default_rng(20260101)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 MiB; mounting takes root."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(disk)]
    if os.getuid() != 0 or subprocess.run(mount, check=False, capture_output=True).returncode != 0:
        pytest.skip("a small disk cannot be mounted here")
    try:
        yield disk
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)
