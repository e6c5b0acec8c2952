"""A cloud that moves with a mesh, written as every product."""

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dynamictree.errors import InputError
from dynamictree.formats.animated_splat import read_animated_splat
from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.splat import write_splat
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.products import SwayingMesh
from dynamictree.splat_products import SplatOptions, animate_splat, load_cloud, mesh_of_moving_part, moving_part


@pytest.fixture(scope="module")
def cloud() -> GaussianCloud:
    """A post of 1 m, and a pot beside it."""
    rng = np.random.default_rng(2)
    angle, height = rng.random(3000) * 2 * np.pi, rng.random(3000)
    post = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), height], axis=1)
    post[2000:] = post[2000:] * [1, 1, 0.2] + [1, 0, 0]
    return GaussianCloud(
        means=post.astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (3000, 1)),
        scales=np.full((3000, 3), 0.02, np.float32),
        opacity=np.full(3000, 0.9, np.float32),
        sh=rng.normal(size=(3000, 1, 3)).astype(np.float32),
        source_up_axis="-Y",
    )


BOX = SplatOptions(formats=("ply", "splat", "png"), box_m=((-0.3, -0.3, -0.1), (0.3, 0.3, 1.1)))


@pytest.fixture(scope="module")
def sway(cloud: GaussianCloud) -> SwayingMesh:
    mesh = mesh_of_moving_part(cloud, BOX)
    coefficients = np.zeros((mesh.num_vertices, 2, 3), np.complex64)
    coefficients[:, 1, 0] = 0.05 * mesh.vertices[:, 2] ** 2
    return SwayingMesh(
        mesh=mesh, coefficients=coefficients, num_frames=4, loop_fps=24.0, phases=np.arange(4) / 4, fps=24.0
    )


def test_all_products_show_one_motion(cloud: GaussianCloud, sway: SwayingMesh, tmp_path: Path) -> None:
    done: list[float] = []
    paths = animate_splat(cloud, sway, BOX, tmp_path, done.append)
    assert done == sorted(done)
    assert done[-1] == 1
    with zipfile.ZipFile(paths["ply"]) as archive:
        frames = [read_cloud(io.BytesIO(archive.read(name)), file_type="ply") for name in archive.namelist()]
    assert len(frames) == 4
    tree = moving_part(cloud, BOX)
    np.testing.assert_array_equal(tree, np.arange(3000) < 2000)
    for frame in frames:
        np.testing.assert_allclose(frame.means[~tree], cloud.means[~tree], atol=1e-6)  # the pot stays
    moved = frames[0].means[tree] - cloud.means[tree]
    expected = 0.1 * cloud.means[tree, 2] ** 2  # w c cos 0, w = 2
    assert np.abs(moved[:, 0] - expected).max() < 0.015
    with paths["splat"].open("rb") as stream:
        assert read_animated_splat(stream).binding.cloud.num_gaussians == 3000
    with Image.open(paths["png"]) as picture:
        pixels = np.asarray(picture).astype(int)
    assert pixels.shape == (512, 1024, 3)
    slices = pixels[:, 512:]
    assert np.abs(slices[0] - slices[256]).max() > 50  # left, then right


def test_a_lighter_product_is_asked_for(cloud: GaussianCloud, sway: SwayingMesh, tmp_path: Path) -> None:
    paths = animate_splat(cloud, sway, replace(BOX, formats=("splat",), share=0.1, sh_degree=0), tmp_path)
    with paths["splat"].open("rb") as stream:
        assert read_animated_splat(stream).binding.cloud.num_gaussians == 300


def test_a_film_is_made(cloud: GaussianCloud, sway: SwayingMesh, tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    few = cloud.subset(np.arange(0, 3000, 3))
    paths = animate_splat(few, sway, replace(BOX, formats=("mp4", "webp")), tmp_path)
    assert b"ftyp" in paths["mp4"].read_bytes()[:12]
    with Image.open(paths["webp"]) as film:
        assert getattr(film, "n_frames", 1) == 4


def test_a_cloud_is_read_by_its_ending(cloud: GaussianCloud, tmp_path: Path) -> None:
    path = tmp_path / "tree.SPLAT"
    with path.open("wb") as stream:
        write_splat(cloud, stream)
    np.testing.assert_allclose(load_cloud(path).means, cloud.means, atol=1e-6)


def test_what_cannot_be_written_is_told(
    cloud: GaussianCloud, sway: SwayingMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match=r"formats are \['glb'\]"):
        SplatOptions(formats=("glb",))
    monkeypatch.setattr("dynamictree.splat_products.MAX_SEQUENCE_BYTES", 1000)
    with pytest.raises(InputError, match="ask for fewer frames"):
        animate_splat(cloud, sway, BOX, tmp_path)
    assert not list(tmp_path.iterdir())
