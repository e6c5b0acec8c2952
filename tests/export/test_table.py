"""The table of products says what each product is and depends on."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from dynamictree.export.table import PRODUCTS
from dynamictree.export.write import write_products
from dynamictree.gaussian.capture import Capture
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import ExportParams, Format, Shot
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.voxelize import voxelize

START = ExportParams(num_frames=4, fps=24.0, shot=Shot(side_px=64))
CHANGED = {
    "first_frame": {"first_frame": 1},
    "num_frames": {"num_frames": 8},
    "fps": {"fps": 12.0, "num_frames": 2},
    "speed": {"speed": 2.0, "num_frames": 2},
    "loop": {"loop": False},
    "share": {"share": 0.5},
    "sh_degree": {"sh_degree": 0},
    "shot": {"shot": Shot(side_px=64, azimuth_deg=120.0)},
}


@pytest.fixture(scope="module")
def capture() -> Capture:
    rng = np.random.default_rng(1)
    angle, height = rng.random(400) * 2 * np.pi, rng.random(400)
    means = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), height], axis=1).astype(np.float32)
    cloud = GaussianCloud(
        means=means,
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (400, 1)),
        scales=np.full((400, 3), 0.03, np.float32),
        opacity=np.full(400, 0.9, np.float32),
        sh=rng.normal(size=(400, 4, 3)).astype(np.float32),
    )
    ring = np.stack([0.1 * np.cos(np.arange(8) * np.pi / 4), 0.1 * np.sin(np.arange(8) * np.pi / 4)], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(8, z)]) for z in np.linspace(0, 1, 6)])
    faces = [
        [8 * row + a, 8 * row + (a + 1) % 8, 8 * (row + up) + (a + (1 - up)) % 8 + 8 * (1 - up)]
        for row in range(5)
        for a in range(8)
        for up in (0, 1)
    ]
    return Capture(
        cloud=cloud, mesh=TriangleMesh(vertices=vertices.astype(np.float32), faces=np.array(faces, np.int32))
    )


@pytest.fixture(scope="module")
def spectrum(capture: Capture) -> SparseVoxelSpectrum:
    assert capture.mesh is not None
    grid = voxelize(capture.mesh, 32).grid
    coefficients = np.zeros((len(grid), 3, 3), np.complex64)
    coefficients[:, 1, 0] = 0.05 * grid.centres_m[:, 2] ** 2
    coefficients[:, 2, 1] = 0.02j * grid.centres_m[:, 2]
    return SparseVoxelSpectrum(grid=grid, coefficients=coefficients, fps=24.0, num_frames=4, model="test")


def test_every_format_of_a_request_is_a_product_with_its_own_file() -> None:
    assert set(PRODUCTS) == set(get_args(Format))
    assert len({product.file_name for product in PRODUCTS.values()}) == len(PRODUCTS)
    assert all(product.write or product.write_film for product in PRODUCTS.values())
    assert PRODUCTS["glb"].media_type == "model/gltf-binary"
    assert PRODUCTS["motion"].media_type == "application/octet-stream"


@pytest.mark.parametrize("name", [name for name in PRODUCTS if name not in ("glb-skinned", "mp4", "usd")])
def test_a_product_depends_on_its_options_alone(
    name: Format, capture: Capture, spectrum: SparseVoxelSpectrum, tmp_path: Path
) -> None:
    def content(params: ExportParams) -> bytes:
        assert capture.mesh is not None
        given = params.model_copy(update={"formats": (name,)})
        return write_products(capture.mesh, spectrum, given, tmp_path, capture=capture)[name].read_bytes()

    before = content(START)
    assert content(START) == before
    for option, change in CHANGED.items():
        depends = not PRODUCTS[name].options.isdisjoint(change)
        assert depends or content(START.model_copy(update=change)) == before, option
    for option in PRODUCTS[name].options - {"loop"}:
        assert content(START.model_copy(update=CHANGED[option])) != before, option
