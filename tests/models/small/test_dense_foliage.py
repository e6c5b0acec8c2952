"""Dense foliage is served: generated on a grid that the network can read, and raised to the one that was asked for."""

import io
import re
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from dynamictree import method
from dynamictree.export.write import write_products
from dynamictree.formats.tensors.spectrum import read_spectrum, write_spectrum
from dynamictree.mesh import TriangleMesh
from dynamictree.models import load_model
from dynamictree.models.small.generate import SmallModel
from dynamictree.requests import ExportParams
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from tests.formats.meshes import written

MAX_BYTES = 4 << 30


def bush(num_cards: int, *, card_m: float, radius_m: float = 2.5) -> TriangleMesh:
    """A ball of square cards at random, on a square trunk."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(num_cards, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    middles = directions * np.cbrt(rng.random((num_cards, 1))) * radius_m + [0, 0, 1.05 * radius_m]
    along, across = np.linalg.qr(rng.normal(size=(num_cards, 3, 2)))[0].transpose(2, 0, 1) * card_m / 2
    cards = middles[:, None] + np.stack([-along - across, along - across, along + across, across - along], axis=1)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.05
    trunk = np.concatenate([np.c_[square, np.zeros(4)], np.c_[square, np.full(4, radius_m)]])
    sides = [(i, (i + 1) % 4, (i + 1) % 4 + 4) for i in range(4)] + [(i, (i + 1) % 4 + 4, i + 4) for i in range(4)]
    squares = 4 * np.arange(num_cards)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return TriangleMesh(
        vertices=np.concatenate([trunk, cards.reshape(-1, 3)]).astype(np.float32),
        faces=np.concatenate([np.array(sides), 8 + squares.reshape(-1, 3)]).astype(np.int32),
    )


def rms_m(spectrum: SparseVoxelSpectrum) -> float:
    """Of the motion about its mean pose."""
    power = np.abs(spectrum.coefficients[:, 1:]) ** 2
    return float(np.sqrt(2 * power.sum(axis=(1, 2)).mean()))


def test_a_bush_moves_as_much_when_it_is_generated_coarsely(tmp_path) -> None:
    mesh = bush(120, card_m=0.2)
    voxels = method.voxelize(mesh)
    shipped = load_model("small")
    small = SmallModel(shipped.network, name="small", max_network_voxels=len(voxels.grid) - 1)
    fine, coarse = (model.generate(voxels, wind=Wind(), seed=0, num_steps=1) for model in (shipped, small))
    assert rms_m(coarse) == pytest.approx(rms_m(fine), rel=0.3)
    assert len(read_spectrum(io.BytesIO(written(write_spectrum, coarse))).grid) == len(voxels.grid)
    assert write_products(mesh, coarse, ExportParams(formats=("glb",)), tmp_path)["glb"].stat().st_size > 0


@pytest.mark.slow
def test_a_million_voxels_are_served_in_bounded_memory() -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
        assert alone.submit(peak_of_a_million_voxels).result() < MAX_BYTES


def peak_of_a_million_voxels() -> int:
    """Bytes that this process has had at most, once it moved a mesh of so many voxels."""
    mesh = bush(110_000, card_m=0.15)
    voxels = method.voxelize(mesh)
    assert 900_000 < len(voxels.grid) < 1_400_000
    spectrum = method.generate(voxels)
    assert len(spectrum.grid) == len(voxels.grid)
    assert np.isfinite(spectrum.coefficients).all()
    assert 0.01 < rms_m(spectrum) < 1.0
    assert np.abs(method.devoxelize(spectrum, mesh)).max() <= 1.5 * np.abs(spectrum.coefficients).max()
    peak = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return 1024 * int(peak[1])
