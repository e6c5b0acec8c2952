"""The table of products says what each product is and depends on."""

import io
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from jaxtyping import Float32
from PIL import Image
from safetensors.numpy import load_file

from dynamictree.errors import InputError
from dynamictree.export.size import min_sequence_bytes
from dynamictree.export.table import PRODUCTS, available_products
from dynamictree.export.write import RIG_SHARE, Recall, write_products
from dynamictree.mesh import Material, MeshLook
from dynamictree.plant.capture import Capture
from dynamictree.requests import TURBULENT_FRAMES, ExportParams, Format, Shot
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.voxelize import voxelize
from tests.clouds import cloud_at
from tests.devoxelize.test_interpolation import merged, tube
from tests.rig.test_no_part_flies import card

START = ExportParams(num_frames=4, fps=4.0, shot=Shot(side_px=64))
CHANGED = {
    "wind_mode": {"wind_mode": "turbulent"},
    "first_frame": {"first_frame": 1},
    "num_frames": {"num_frames": 8},
    "fps": {"fps": 2.0, "num_frames": 2},
    "speed": {"speed": 2.0, "num_frames": 2},
    "loop": {"loop": False},
    "flutter": {"flutter": 0.0},
    "share": {"share": 0.5},
    "sh_degree": {"sh_degree": 0},
    "shot": {"shot": Shot(side_px=64, azimuth_deg=120.0)},
    "normals": {"normals": True},
    "joints": {"joints": 256},
    "glb_compression": {"glb_compression": "meshopt"},
    "glb_textures": {"glb_textures": "webp"},
}

SLOW = ("lod", "rig", "wind", "usd", "usd-skinned", "usd-splat", "html-splat", "mp4", "png")
SAME_AT_THIS_SIZE = {("glb", "joints"), ("usd-skinned", "joints")}  # 52 vertices need fewer than the least allowed


@pytest.fixture(scope="module")
def capture() -> Capture:
    rng = np.random.default_rng(1)
    angle, height = rng.random(400) * 2 * np.pi, rng.random(400)
    means = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), height], axis=1).astype(np.float32)
    means[:40] = np.stack([0.15 + 0.1 * rng.random(40), 0.04 * rng.random(40), np.full(40, 0.8)], axis=1)  # on the card
    cloud = cloud_at(means, scale=0.03, sh=rng.normal(size=(400, 4, 3)))
    leaf = card(np.array([0.2, 0, 0.8]), np.array([[0.1, 0, 0], [0, 0.1, 0]]))
    post, _ = merged(tube([0, 0, 0], [0, 0, 1], 0.1, rings=6, sides=8), leaf)
    bark = io.BytesIO()
    Image.linear_gradient("L").resize((64, 64)).convert("RGB").save(bark, "PNG", compress_level=1)
    look = MeshLook(uv=post.vertices[:, 1:].copy(), materials=(Material(texture_png=bark.getvalue()),))
    return Capture(cloud=cloud, mesh=replace(post, look=look))


@pytest.fixture(scope="module")
def spectrum(capture: Capture) -> SparseVoxelSpectrum:
    grid = voxelize(capture.mesh, 32).grid
    coefficients = np.zeros((len(grid), 3, 3), np.complex64)
    coefficients[:, 1, 0] = 0.05 * grid.centres_m[:, 2] ** 2
    coefficients[:, 2, 1] = 0.02j * grid.centres_m[:, 2]
    return SparseVoxelSpectrum(grid=grid, coefficients=coefficients, num_frames=24, wind=Wind(speed_m_s=15.0))


def test_every_format_of_a_request_is_a_product_with_its_own_file() -> None:
    assert set(PRODUCTS) == set(get_args(Format))
    assert len({product.file_name for product in PRODUCTS.values()}) == len(PRODUCTS)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in PRODUCTS]
)
def test_a_product_depends_on_its_options_alone(
    name: Format, capture: Capture, spectrum: SparseVoxelSpectrum, recall: Recall, tmp_path
) -> None:
    def content(params: ExportParams) -> bytes:
        given = params.model_copy(update={"formats": (name,)})
        paths = write_products(capture.mesh, spectrum, given, tmp_path, capture=capture, recall=recall)
        return paths[name].read_bytes()

    before = content(START)
    assert content(START) == before
    apart = [change for change in CHANGED.values() if PRODUCTS[name].options.isdisjoint(change)]
    if name not in TURBULENT_FRAMES:
        apart.remove(CHANGED["wind_mode"])
        with pytest.raises(InputError, match=f"format {name} holds one period"):
            content(START.model_copy(update=CHANGED["wind_mode"]))
    together = {field: value for change in apart for field, value in change.items()}
    assert content(START.model_copy(update=together)) == before, together
    for option in PRODUCTS[name].options - {"loop"}:
        same = (name, option) in SAME_AT_THIS_SIZE
        assert same == (content(START.model_copy(update=CHANGED[option])) == before), option


def test_a_turbulent_motion_can_be_written_in_parts(
    capture: Capture, spectrum: SparseVoxelSpectrum, recall: Recall, tmp_path
) -> None:
    def displacement(**fields: int) -> Float32[np.ndarray, "T N 3"]:
        params = ExportParams(wind_mode="turbulent", formats=("motion",), **fields)
        paths = write_products(capture.mesh, spectrum, params, tmp_path, recall=recall)
        return load_file(paths["motion"])["displacement"]

    whole = displacement()
    assert len(whole) == 240
    assert np.array_equal(displacement(first_frame=190, num_frames=50), whole[190:])
    assert displacement(num_frames=1, first_frame=1_000_000).any()


def test_a_long_film_is_written_as_it_is_drawn(
    capture: Capture, spectrum: SparseVoxelSpectrum, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr("dynamictree.render.video.stored_frames", None)  # no picture is stored
    params = ExportParams(
        wind_mode="turbulent", num_frames=20, formats=("mp4", "png"), shot=Shot(side_px=64, ground=False)
    )
    drawn: list[float] = []
    paths = write_products(capture.mesh, spectrum, params, tmp_path, drawn.append, capture=capture)
    assert all(path.stat().st_size > 1000 for path in paths.values())
    assert len([share for share in drawn if share > RIG_SHARE]) <= 20 + 4


def test_files_of_a_turbulent_motion_have_a_largest_size(
    capture: Capture, spectrum: SparseVoxelSpectrum, tmp_path, monkeypatch
) -> None:
    formats: tuple[Format, ...] = ("ply", "motion")
    params = ExportParams(wind_mode="turbulent", num_frames=32, formats=formats)
    stated = min_sequence_bytes(formats, 32, params, mesh=(48, 80))
    for name, path in write_products(capture.mesh, spectrum, params, tmp_path).items():
        assert 1 <= path.stat().st_size / stated[name] < 1.6
        path.unlink()
    monkeypatch.setattr("dynamictree.export.size.MAX_SEQUENCE_BYTES", 10_000)
    for name in ("ply", "usd", "alembic", "motion"):
        params = ExportParams(wind_mode="turbulent", num_frames=600, formats=(name,))
        with pytest.raises(InputError, match=f"600 frames of 52 vertices as {name}"):
            write_products(capture.mesh, spectrum, params, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_format_without_its_library_says_how_to_install_it(
    capture: Capture, spectrum: SparseVoxelSpectrum, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr("dynamictree.export.table.find_spec", lambda name: None)
    assert not {"usd", "mp4"} & set(available_products())
    assert {"glb", "vat", "png"} <= set(available_products())
    params = ExportParams(formats=("glb", "usd"), num_frames=4)
    with pytest.raises(InputError, match=r"format usd needs .* pxr, .*pip install 'dynamictree\[usd\]'"):
        write_products(capture.mesh, spectrum, params, tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_page_on_engines_lists_every_product() -> None:
    page = (Path(__file__).parents[2] / "docs" / "engines.md").read_text(encoding="utf-8")
    rows = [line for line in page.partition("## Choose a format")[2].splitlines() if line.startswith("| `")]
    assert [name for name in PRODUCTS if not any(f"`{name}`" in row for row in rows)] == []
