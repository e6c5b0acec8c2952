"""The product `wind`: its files give the library's turbulent motion to an evaluator that is not the library's."""

import io
import json
import re
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
from dynamictree.export.engine_wind import SHADERS
from dynamictree.export.moving_tree import iter_turbulent_turns
from dynamictree.export.write import write_products
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.modal.turbulence import turbulent_wind
from dynamictree.requests import ExportParams
from dynamictree.rig.branch_groups import branches_of
from dynamictree.rig.branch_pivots import branch_pivots
from dynamictree.rig.rig import rig_of
from dynamictree.rig.surface_skeleton import surface_bones
from dynamictree.spectrum import SparseVoxelSpectrum, Wind, bin_weights
from dynamictree.wind_bands import bands_of_sizes
from lab.dataset.sample import make_sample, voxel_spectrum

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
    sample = make_sample(3, "sapling", wind=Wind(speed_m_s=5.3, direction_deg=160.0, gust=0.42))
    return sample.mesh, with_gains(voxel_spectrum(sample, 64)[1])


@pytest.fixture(scope="module")
def archive(tree: Tree, tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    path = write_products(*tree, ExportParams(formats=("wind",)), tmp_path_factory.mktemp("wind"))["wind"]
    return zipfile.ZipFile(io.BytesIO(path.read_bytes()))


def test_bones_in_the_file_are_the_librarys(archive: zipfile.ZipFile, tree: Tree) -> None:
    mesh, spectrum = tree
    engine = read_engine_wind(archive)
    rig = rig_of(mesh, spectrum)
    skeleton, turns = rig.skeleton, rig.turns
    np.testing.assert_array_equal(engine.parent, skeleton.parent)
    np.testing.assert_array_equal(engine.bone, rig.vertices.rows[:, 0])
    np.testing.assert_allclose(engine.parent_share, rig.vertices.shares[:, 1], atol=1e-6)
    np.testing.assert_allclose(engine.foot_m, skeleton.foot_m, atol=2e-3)
    reach = np.linalg.norm(skeleton.reach_m, axis=1, keepdims=True)
    np.testing.assert_allclose(engine.direction * reach, skeleton.reach_m, atol=2e-3)
    weights = bin_weights(turns.shape[1], spectrum.num_frames)[:, None]
    np.testing.assert_allclose(engine.turns[0], turns[:, 0].real, atol=2e-3)
    np.testing.assert_allclose(engine.turns[1::2], (weights[1:] * turns[:, 1:].real).transpose(1, 0, 2), atol=2e-3)
    np.testing.assert_allclose(engine.turns[2::2], (weights[1:] * turns[:, 1:].imag).transpose(1, 0, 2), atol=2e-3)


@pytest.mark.parametrize("seconds", SECONDS)
def test_the_reference_moves_vertices_as_the_modes_in_the_motions_own_wind(
    archive: zipfile.ZipFile, tree: Tree, seconds: float
) -> None:
    mesh, spectrum = tree
    own = turbulent_wind(spectrum, seed=spectrum.seed)
    rig = rig_of(mesh, spectrum)
    theta = next(iter_turbulent_turns(rig, own, np.array([seconds])))
    expected = rig.displacement(theta, mesh.vertices, rig.vertices)
    apart = np.linalg.norm(read_engine_wind(archive).displacement(seconds) - expected, axis=1)
    size = np.sqrt((expected**2).sum(axis=1).mean())
    assert size > 0.02
    assert np.sqrt((apart**2).mean()) < 0.002 * size  # half floats in the texture


def test_edges_and_cards_keep_their_size_in_a_storm(archive: zipfile.ZipFile, tree: Tree) -> None:
    mesh, spectrum = tree
    moved = read_engine_wind(archive).displacement(3.7, STORM_M_S)
    cards = surface_bones(mesh, spectrum.grid).in_card[mesh.faces].all(axis=1)
    assert 0.1 < cards.mean() < 0.9
    corners = mesh.vertices[mesh.faces[cards]].astype(np.float64)
    growth = np.abs(areas(corners + moved[mesh.faces[cards]]) / areas(corners) - 1)
    assert growth.max() < 1e-3
    assert stretch(mesh, moved) < 0.01


def stretch(mesh: TriangleMesh, moved: np.ndarray) -> float:
    """99th percentile over the edges."""
    start, end = edges_of(mesh.faces).T
    rest = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
    now = np.linalg.norm(mesh.vertices[start] + moved[start] - mesh.vertices[end] - moved[end], axis=1)
    return float(np.percentile(np.abs(now / rest - 1), 99))


def areas(corners: np.ndarray) -> np.ndarray:
    """Of triangles [F, 3, 3]."""
    return np.asarray(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))


def test_baked_attributes_say_what_the_motion_says(archive: zipfile.ZipFile, tree: Tree) -> None:
    mesh, spectrum = tree
    document = pygltflib.GLTF2().load_from_bytes(archive.read("tree-wind.glb"))
    attributes = document.meshes[0].primitives[0].attributes
    colour = accessor(document, attributes.COLOR_0) / 65535
    shapes = method.devoxelize(spectrum, mesh)
    pivots = branch_pivots(rig_of(mesh, spectrum), mesh.vertices)
    assert colour[:, 0].max() == 1
    top, foot = mesh.vertices[:, 2].argmax(), mesh.vertices[:, 2].argmin()
    assert colour[top, 0] > 0.2 > colour[foot, 0]
    assert np.ptp(colour[:, 1]) > 0.1
    assert colour[colour[:, 0] > 0, 2].min() > 0  # a foot in the ground stands still
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
    pivots = branch_pivots(rig_of(mesh, spectrum), mesh.vertices)
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


MOST_LINES = {
    "wind-three.js": 120,
    "wind-godot-poses.gdshader": 70,
    "wind-unity.shader": 90,
    "wind-unreal-poses.hlsl": 70,
}
"""Of what computes the bones; 60 of what is put into a tree's material."""


def test_shaders_are_short_and_have_the_numbers_inside(archive: zipfile.ZipFile) -> None:
    for name in SHADERS:
        text = archive.read(name).decode()
        assert len([line for line in text.splitlines() if not line.startswith("#define")]) <= MOST_LINES.get(name, 60)
        assert not re.search("CORE|SURFACE|CONSTANTS|LAYOUT|_TABLE|TEXTURE|POSES_|OWN_M_S", text)
        assert not re.search(r"\b(vec[23]|mix|fract)\b", text) or not name.endswith((".hlsl", ".shader"))


UNITY_TYPES = """Texture2D T; SamplerState S;
struct UnityTexture2D { Texture2D tex; }; struct UnitySamplerState { SamplerState samplerstate; };
struct v2f_customrendertexture { float3 localTexcoord; }; static const float4 _Time = float4(0, 1, 2, 3);
"""


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("wind-unity.hlsl", "UnityTexture2D t = { T }; UnitySamplerState s = { S }; Wind_float(l.xy, l, t, s, d);"),
        ("wind-unity.shader", "v2f_customrendertexture v = { l }; d = frag(v).xyz;"),
        ("wind-unreal.hlsl", "d = custom(T, S, l.xy, l);"),
        ("wind-unreal-poses.hlsl", "d = custom(T, S, l.xy, l.x, l.y);"),
    ],
)
def test_glslang_compiles_the_hlsl(archive: zipfile.ZipFile, name: str, call: str, tmp_path: Path) -> None:
    """Needs Debian's `glslang-tools`; the engines' own types and wrappers stand around the code."""
    if shutil.which("glslangValidator") is None:
        pytest.skip("glslangValidator is not there: apt-get install glslang-tools")
    text = archive.read(name).decode()
    if name.endswith(".shader"):
        text = (
            text.partition("CGPROGRAM")[2]
            .partition("ENDCG")[0]
            .replace('#include "UnityCustomRenderTexture.cginc"', "")
        )
    elif "unreal" in name:
        code = text.partition("TreeWind tree;")
        inputs = {
            "wind-unreal.hlsl": "Texture2D Poses, SamplerState PosesSampler, float2 Lookup, float3 Place",
            "wind-unreal-poses.hlsl": "Texture2D Bones, SamplerState BonesSampler, float2 Texel, float Seconds, "
            "float Speed",
        }
        text = f"{code[0]}float3 custom({inputs[name]}) {{ TreeWind tree; {code[2]} }}\n"
    main = f"float4 main(float3 l : A) : SV_Position {{ float3 d; {call} return float4(d, 1); }}"
    (tmp_path / "wind.hlsl").write_text(f"{UNITY_TYPES}{text}\n{main}")
    command = ["glslangValidator", "-D", "-S", "vert", "-e", "main", "-V", "wind.hlsl", "-o", "wind.spv"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout
