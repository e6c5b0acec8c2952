"""The product `wind`: its files give the library's turbulent motion to an evaluator that is not the library's."""

import io
import json
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pygltflib
import pytest
from PIL import Image

from benchmarks._engine_wind import read_engine_wind
from benchmarks._played import accessor, z_up
from dynamictree import method
from dynamictree.dataset.sample import make_sample, voxel_spectrum
from dynamictree.export.engine_wind import SHADERS
from dynamictree.export.write import write_products
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.branch_groups import branches_of
from dynamictree.modal.branch_pivots import branch_pivots
from dynamictree.modal.turbulence import iter_turbulent_motion, turbulent_wind
from dynamictree.requests import ExportParams
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.wind_bands import bands_of_sizes

Tree = tuple[TriangleMesh, SparseVoxelSpectrum]
SECONDS = (0.0, 3.7, 412.0)
STORM_M_S = 20.0


def with_gains(spectrum: SparseVoxelSpectrum) -> SparseVoxelSpectrum:
    """Each mode as much stronger in a storm as its number says."""
    assert spectrum.wind is not None
    own = spectrum.wind.speed_m_s
    return replace(spectrum, bands=bands_of_sizes({own: np.ones(16), STORM_M_S: np.arange(1.0, 17) / 4}, own))


@pytest.fixture(scope="module")
def tree() -> Tree:
    sample = make_sample(3, "sapling")
    return sample.mesh, with_gains(voxel_spectrum(sample, 32)[1])


@pytest.fixture(scope="module")
def archive(tree: Tree, tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    path = write_products(*tree, ExportParams(formats=("wind",)), tmp_path_factory.mktemp("wind"))["wind"]
    return zipfile.ZipFile(io.BytesIO(path.read_bytes()))


@pytest.mark.parametrize("speed_m_s", [None, STORM_M_S])
def test_the_reference_moves_wood_as_the_library_does(
    archive: zipfile.ZipFile, tree: Tree, speed_m_s: float | None
) -> None:
    mesh, spectrum = tree
    engine = read_engine_wind(archive)
    shapes = method.devoxelize(spectrum, mesh)
    own = turbulent_wind(spectrum, seed=spectrum.seed)
    own = own if speed_m_s is None else replace(own, wind=replace(own.wind, speed_m_s=speed_m_s))
    truth = list(iter_turbulent_motion(shapes, own, np.array(SECONDS), spectrum.num_frames))
    wood = ~engine.in_card
    assert 0.1 < wood.mean() < 0.9
    for seconds, expected in zip(SECONDS, truth, strict=True):
        moved = engine.displacement(seconds, speed_m_s)
        assert np.linalg.norm(moved - expected, axis=1)[wood].max() < 1e-3
        assert np.linalg.norm(expected, axis=1)[wood].max() > 0.02


def test_cards_keep_their_size_in_a_storm_and_move_as_the_modes_in_a_breeze(
    archive: zipfile.ZipFile, tree: Tree
) -> None:
    mesh, spectrum = tree
    engine = read_engine_wind(archive)
    shapes = method.devoxelize(spectrum, mesh)
    own = turbulent_wind(spectrum, seed=spectrum.seed)
    cards = engine.in_card[mesh.faces].all(axis=1)
    corners = mesh.vertices[mesh.faces[cards]].astype(np.float64)
    for speed_m_s in (1.0, STORM_M_S):
        windy = replace(own, wind=replace(own.wind, speed_m_s=speed_m_s))
        summed = next(iter_turbulent_motion(shapes, windy, np.array([3.7]), spectrum.num_frames))
        moved = engine.displacement(3.7, speed_m_s)
        growth = np.abs(areas(corners + moved[mesh.faces[cards]]) / areas(corners) - 1)
        assert growth.max() < 1e-3
        if speed_m_s == 1.0:
            apart = np.linalg.norm(moved - summed, axis=1)
            assert apart.max() < 0.1 * np.linalg.norm(summed, axis=1).max()
        else:
            grown = np.abs(areas(corners + summed[mesh.faces[cards]]) / areas(corners) - 1)
            assert np.percentile(grown, 99) > 0.02  # what a sum of modes makes of them


def areas(corners: np.ndarray) -> np.ndarray:
    """Of triangles [F, 3, 3]."""
    return np.asarray(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))


def test_baked_attributes_say_what_the_motion_says(archive: zipfile.ZipFile, tree: Tree) -> None:
    mesh, spectrum = tree
    document = pygltflib.GLTF2().load_from_bytes(archive.read("tree-wind.glb"))
    attributes = document.meshes[0].primitives[0].attributes
    colour = accessor(document, attributes.COLOR_0) / 65535
    shapes = method.devoxelize(spectrum, mesh)
    pivots = branch_pivots(spectrum, mesh, shapes)
    assert colour[:, 0].max() == 1
    top, foot = mesh.vertices[:, 2].argmax(), mesh.vertices[:, 2].argmin()
    assert colour[top, 0] > 0.2 > colour[foot, 0]
    assert np.ptp(colour[:, 1]) > 0.1
    assert colour[:, 2].min() > 0
    assert (colour[:, 3] == 1).all()
    first, second = accessor(document, attributes.TEXCOORD_1), accessor(document, attributes.TEXCOORD_2)
    pivot = z_up(np.column_stack([first, second[:, 0]]))
    np.testing.assert_allclose(pivot, pivots.pivot_m, atol=1e-6)
    assert second[:, 1].min() == 0
    assert second[:, 1].max() >= 1
    largest = document.asset.extras["largest_weight_m"]
    weights = np.sqrt((np.abs(shapes[:, 0]) ** 2).sum(axis=1) + 2 * (np.abs(shapes[:, 1:]) ** 2).sum(axis=(1, 2)))
    np.testing.assert_allclose(colour[:, 0] * largest, weights, atol=1e-4 * largest)


def test_pivot_painter_textures_are_read_as_the_branches(archive: zipfile.ZipFile, tree: Tree, tmp_path: Path) -> None:
    mesh, spectrum = tree
    names = json.loads(archive.read("wind.json"))["pivot_painter"]
    texels = OpenEXR.File(archive.extract(names["position_and_index"], tmp_path)).channels()["RGBA"].pixels
    height, width, _ = texels.shape
    picture = np.asarray(Image.open(io.BytesIO(archive.read(names["x_vector_and_extent"]))))
    assert picture.shape == (height, width, 4)
    document = pygltflib.GLTF2().load_from_bytes(archive.read(names["mesh"]))
    u, v = accessor(document, document.meshes[0].primitives[0].attributes.TEXCOORD_1).T
    texel = np.floor(v * height).astype(int) * width + np.floor(u * width).astype(int)
    pivot_cm = texels[..., :3].reshape(-1, 3).astype(np.float64)
    parent = np.ascontiguousarray(texels[..., 3]).astype(np.float16).view(np.uint16).reshape(-1).astype(int) - 1024
    axis = picture[..., :3].reshape(-1, 3) / 255 * 2 - 1
    extent_cm = np.round(picture[..., 3].reshape(-1) / 255 * 256) * 8
    pivots = branch_pivots(spectrum, mesh, method.devoxelize(spectrum, mesh))
    used = np.unique(texel)
    assert len(used) > 3
    np.testing.assert_array_equal(texel, pivots.branch)
    unreal_cm = mesh.vertices.astype(np.float64) * [100, -100, 100]
    np.testing.assert_allclose(pivot_cm[texel], pivots.foot_m[pivots.branch] * [100, -100, 100], atol=0.13)
    np.testing.assert_allclose(np.linalg.norm(axis[used], axis=1), 1, atol=0.02)
    along = np.einsum("nc,nc->n", unreal_cm - pivot_cm[texel], axis[texel])
    for branch in used:
        assert -9 < extent_cm[branch] - max(along[texel == branch].max(), 8) < 12
    steps, above = 0, np.arange(len(pivots.parent))
    while (parent[above] != above).any():
        above, steps = parent[above], steps + 1
    assert steps <= 3  # what PivotPainter2FoliageShader follows
    assert parent[0] == 0
    foot = mesh.vertices[:, 2].argmin()
    assert texel[foot] == 0


def test_a_branch_goes_on_in_one_child_and_finer_ones_than_four_levels_in_all(rng: np.random.Generator) -> None:
    branch, first = branches_of(np.array([-1, 0, 1, 2, 3, 1, 5, 5], np.int32))
    assert (branch.tolist(), first.tolist()) == ([0, 0, 0, 0, 0, 1, 1, 2], [0, 5, 7])
    parent = np.array([-1, *(rng.integers(max(0, joint - 6), joint) for joint in range(1, 400))], np.int32)
    branch, first = branches_of(parent)
    goes_on = branch[1:] == branch[parent[1:]]
    np.testing.assert_array_equal(np.flatnonzero(~goes_on) + 1, first[1:])
    steps = [0]
    for joint in first[1:]:
        steps.append(steps[branch[parent[joint]]] + 1)
    assert max(steps) == 3
    for joint in range(400):
        children = np.flatnonzero(parent == joint)
        same = (branch[children] == branch[joint]).sum()
        assert same == (len(children) if steps[branch[joint]] == 3 else min(len(children), 1))


def test_a_tree_that_moves_as_one_piece_turns_about_its_foot(tree: Tree) -> None:
    mesh, spectrum = tree
    still = SparseVoxelSpectrum(grid=spectrum.grid, coefficients=np.zeros_like(spectrum.coefficients))
    pivots = branch_pivots(still, mesh, np.zeros((mesh.num_vertices, 16, 3), np.complex64))
    assert len(pivots.order) == mesh.num_vertices
    assert pivots.order.min() == 0
    assert (pivots.parent.tolist(), pivots.branch.max()) == ([0], 0)


def test_shaders_are_short_and_have_the_numbers_inside(archive: zipfile.ZipFile) -> None:
    for name in SHADERS:
        text = archive.read(name).decode()
        assert len([line for line in text.splitlines() if not line.startswith("#define")]) <= 60
        assert not any(word in text for word in ("CORE", "CONSTANTS", "_TABLE", "TEXTUREvec2"))
        assert ("vec2" in text) != name.endswith(".hlsl")


@pytest.mark.parametrize("name", ["wind-unity.hlsl", "wind-unreal.hlsl"])
def test_glslang_compiles_the_hlsl(archive: zipfile.ZipFile, name: str, tmp_path: Path) -> None:
    """Needs Debian's `glslang-tools`; the engines' own types and wrappers stand around the code."""
    if shutil.which("glslangValidator") is None:
        pytest.skip("glslangValidator is not there: apt-get install glslang-tools")
    text = archive.read(name).decode()
    if "unity" in name:
        types = "struct UnityTexture2D { Texture2D tex; }; struct UnitySamplerState { SamplerState samplerstate; };"
        call = "UnityTexture2D t = { T }; UnitySamplerState s = { S }; float3 d; Wind_float(l, 1, 8, t, s, d);"
        text = f"Texture2D T; SamplerState S; {types}\n{text}float4 main(float2 l : A) : SV_Position {{ {call} "
    else:
        code = text.partition("TreeWind tree;")
        head = "Texture2D Modes; SamplerState ModesSampler;\n"
        start = f"{head}{code[0]}float3 custom(float2 Lookup, float Seconds, float Speed) {{ TreeWind tree;"
        text = f"{start}{code[2]} }}\nfloat4 main(float2 l : A) : SV_Position {{ float3 d = custom(l, 1, 8);"
    (tmp_path / "wind.hlsl").write_text(text + " return float4(d, 1); }")
    command = ["glslangValidator", "-D", "-S", "vert", "-e", "main", "-V", "wind.hlsl", "-o", "wind.spv"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout
