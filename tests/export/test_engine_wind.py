"""The product `wind`: its files give the library's turbulent motion to an evaluator that is not the library's."""

import io
import re
import shutil
import subprocess
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from benchmarks._engine_wind import read_engine_wind
from dynamictree.export.engine_wind import SHADERS
from dynamictree.export.moving_tree import iter_turbulent_turns
from dynamictree.export.write import write_products
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.turbulence import turbulent_wind
from dynamictree.requests import ExportParams
from dynamictree.rig.flutter import flutter_of
from dynamictree.rig.rig import rig_of
from dynamictree.rig.surface_skeleton import surface_bones
from dynamictree.spectrum import SparseVoxelSpectrum, Wind, bin_weights
from dynamictree.wind_bands import bands_of_sizes
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.devoxelize.test_interpolation import stretch

Tree = tuple[TriangleMesh, SparseVoxelSpectrum]
SECONDS = (0.0, 3.7, 412.0)
STORM_M_S = 20.0


def with_gains(spectrum: SparseVoxelSpectrum) -> SparseVoxelSpectrum:
    """Each mode as much stronger in a storm as its number says."""
    own = spectrum.wind.speed_m_s
    return replace(spectrum, bands=bands_of_sizes({own: np.ones(16), STORM_M_S: np.arange(1.0, 17) / 4}, own))


@pytest.fixture(scope="module")
def tree() -> Tree:
    sample = make_sample(3, "sapling", wind=Wind(speed_m_s=5.3, direction_deg=160.0, gust=0.42))
    return sample.mesh, with_gains(voxel_spectrum(sample, 64)[1])


@pytest.fixture(scope="module")
def archive(tree: Tree, tmp_path_factory) -> zipfile.ZipFile:
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
    theta = next(iter_turbulent_turns(rig, own, np.array([seconds]), flutter_of(rig, spectrum)))
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
    assert np.abs(areas(corners + moved[mesh.faces[cards]]) / areas(corners) - 1).max() < 1e-3
    assert np.percentile(stretch(mesh, moved[None]), 99) < 0.01


def areas(corners: np.ndarray) -> np.ndarray:
    """Of triangles [F, 3, 3]."""
    return np.asarray(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))


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
def test_glslang_compiles_the_hlsl(archive: zipfile.ZipFile, name: str, call: str, tmp_path) -> None:
    """Needs Debian's `glslang-tools`; the engines' own types and wrappers stand around the code."""
    if shutil.which("glslangValidator") is None:
        pytest.skip("glslangValidator is not there: apt-get install glslang-tools")
    text = archive.read(name).decode()
    if name.endswith(".shader"):
        text = text.partition("CGPROGRAM")[2].partition("ENDCG")[0]
        text = text.replace('#include "UnityCustomRenderTexture.cginc"', "")
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
