"""Every product that shows a mesh, of one small tree in motion."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from dynamictree.export.moving_tree import Facts
from dynamictree.export.table import PRODUCTS
from dynamictree.export.write import Recall, Result, write_products
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import ExportParams
from dynamictree.spectrum import SparseVoxelSpectrum
from lab.dataset.sample import make_sample, voxel_spectrum

FPS, NUM_FRAMES = 7.68, 32  # the same loop, with few frames
Sapling = tuple[TriangleMesh, SparseVoxelSpectrum]
Products = tuple[dict[str, Path], dict[str, Facts]]


@pytest.fixture(scope="module")
def recall(tmp_path_factory) -> Recall:
    """Stores the rig of a module's one motion."""
    path: Path = tmp_path_factory.mktemp("rig") / "rig"

    def stored(result: Result, make: Callable[[Path], None]) -> Path:
        if not path.exists():
            make(path)
        return path

    return stored


@pytest.fixture(scope="session")
def sapling() -> Sapling:
    sample = make_sample(3, "sapling")
    return sample.mesh, replace(voxel_spectrum(sample, 64)[1], fps=FPS, num_frames=NUM_FRAMES)


@pytest.fixture(scope="session")
def products(sapling: Sapling, tmp_path_factory) -> Products:
    """Files by product, and what each states of itself."""
    facts: dict[str, Facts] = {}
    formats = tuple(name for name, product in PRODUCTS.items() if product.shows == "mesh")
    options = ExportParams(formats=formats, fps=FPS, joints=64, flutter=0.0)
    return write_products(*sapling, options, tmp_path_factory.mktemp("products"), on_facts=facts.__setitem__), facts
