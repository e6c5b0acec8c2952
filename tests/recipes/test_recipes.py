"""Recipes do what they say: a forest in which no two trees move alike, and a timeline in Blender."""

import io
import os
import re
import subprocess
from dataclasses import replace
from itertools import combinations, pairwise, product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pygltflib
import pytest
from pxr import Usd, UsdGeom

from benchmarks._read_exports import accessor, read_morphs, z_up
from dynamictree import method
from dynamictree.commands.input_files import load_mesh
from dynamictree.errors import InputError
from dynamictree.formats.gltf.motion import loop_parts, loop_weights, write_motion_glb
from dynamictree.formats.gltf.writer import write_glb
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.tensors.spectrum import read_spectrum, write_spectrum
from dynamictree.spectrum import iter_motion
from lab.dataset.sample import Sample, make_sample, voxel_spectrum
from recipes import blender_import, forest, gallery
from recipes.forest_glb import TravellingGusts, plant_forest
from tests.formats.meshes import written

COUNT = 9
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def sample() -> Sample:
    return make_sample(7, "sapling")  # no frequency of its gusts outweighs the others


@pytest.fixture(scope="module")
def planted(sample: Sample, tmp_path_factory: pytest.TempPathFactory) -> pygltflib.GLTF2:
    folder = tmp_path_factory.mktemp("forest")
    (folder / "tree.glb").write_bytes(written(write_glb, sample.mesh))
    (folder / "tree.spectrum.safetensors").write_bytes(written(write_spectrum, voxel_spectrum(sample, 32)[1]))
    output = planted_as(folder / "forest.glb")
    document = pygltflib.GLTF2().load(str(output))
    document.path = output
    return document


def planted_as(output: Path, *options: str) -> Path:
    """The forest of the tree in the same folder."""
    inputs = [str(output.with_name(name)) for name in ("tree.glb", "tree.spectrum.safetensors")]
    forest.main([*inputs, "-o", str(output), "--trees", str(COUNT), *options])
    return output


def require_same_places(placed: np.ndarray, planted: pygltflib.GLTF2) -> None:
    """Places, +Z up, and sizes are those of the trees of which each has its own motion."""
    there = np.array([[*z_up(np.array([node.translation]))[0], node.scale[0]] for node in planted.nodes])
    np.testing.assert_allclose(placed[placed[:, 0].argsort()], there[there[:, 0].argsort()], atol=1e-5)


def motions(document: pygltflib.GLTF2) -> np.ndarray:
    """Of every tree, in the world less its place: [trees, T + 1, N, 3]."""
    targets = np.stack([accessor(document, target["POSITION"]) for target in document.meshes[0].primitives[0].targets])
    moved = []
    for node, sampler in zip(document.nodes, document.animations[0].samplers, strict=True):
        keys = accessor(document, sampler.output).reshape(-1, len(targets))
        local = np.einsum("tm,mnc->tnc", keys, targets) * np.array(node.scale)
        angle = 2 * np.arctan2(node.rotation[1], node.rotation[3]) if node.rotation else 0.0
        cos, sin = np.cos(angle), np.sin(angle)
        moved.append(z_up(local @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])))
    return np.stack(moved)


def test_no_two_trees_move_alike_at_any_shift_in_time(planted: pygltflib.GLTF2) -> None:
    targets = [accessor(planted, target["POSITION"]) for target in planted.meshes[0].primitives[0].targets]
    gram = np.array([[float((a * b).sum()) for b in targets] for a in targets])
    weights = [accessor(planted, s.output).reshape(-1, len(targets))[:-1] for s in planted.animations[0].samplers]
    sway = [own - own.mean(axis=0) for own in weights]
    size = [np.einsum("tm,mk,tk->", own, gram, own) for own in sway]
    likeness = {
        (a, b): max(
            np.einsum("tm,mk,tk->", sway[a], gram, np.roll(sway[b], shift, axis=0)) / np.sqrt(size[a] * size[b])
            for shift in range(100)
        )
        for a, b in combinations(range(COUNT), 2)
    }
    assert max(likeness.values()) < 0.95
    alone = np.einsum("tm,mk,tk->", sway[0], gram, np.roll(sway[0], 30, axis=0)) / size[0]
    assert alone < 1  # a tree at another time is not itself, so that the measure means something
    np.testing.assert_allclose(size, size[0], rtol=1e-4)  # all sway as strongly


def test_every_tree_closes_its_loop_and_leans_with_the_wind(planted: pygltflib.GLTF2, sample: Sample) -> None:
    moved = motions(planted)
    np.testing.assert_allclose(moved[:, 0], moved[:, -1], atol=1e-6)
    scale = np.array([node.scale[0] for node in planted.nodes])
    wind = np.deg2rad(sample.wind.direction_deg)
    lean = moved[:, :-1].mean(axis=(1, 2)) / scale[:, None]  # [trees, 3]
    along = lean[:, :2] @ [np.cos(wind), np.sin(wind)]
    across = np.abs(lean[:, :2] @ [-np.sin(wind), np.cos(wind)])
    np.testing.assert_allclose(along, along[0], rtol=1e-3)
    np.testing.assert_allclose(across, across[0], rtol=1e-2, atol=1e-6)
    mirrored = [node.scale[2] < 0 for node in planted.nodes]
    assert 0 < sum(mirrored) < COUNT


def test_trees_share_one_mesh_and_stand_apart(planted: pygltflib.GLTF2) -> None:
    assert len(planted.meshes) == 1
    assert {node.mesh for node in planted.nodes} == {0}
    assert planted.scenes[0].nodes == list(range(COUNT))
    places = np.array([node.translation for node in planted.nodes])
    assert min(np.linalg.norm(a - b) for a, b in combinations(places, 2)) > 0.3
    np.testing.assert_allclose(places[:, 1], 0, atol=1e-6)


def test_a_forest_as_usd_has_instances_of_few_motions(planted: pygltflib.GLTF2, sample: Sample) -> None:
    folder = planted.path.parent
    stage = Usd.Stage.Open(str(planted_as(folder / "forest.usdz", "--motions", "3")))
    instancer = UsdGeom.PointInstancer(stage.GetDefaultPrim())
    motions = [stage.GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetTargets()]
    assert len(motions) == 3
    assert sorted(np.bincount(instancer.GetProtoIndicesAttr().Get()).tolist()) == [3, 3, 3]
    placed = np.column_stack([instancer.GetPositionsAttr().Get(), np.array(instancer.GetScalesAttr().Get())[:, 0]])
    require_same_places(placed, planted)
    with (folder / "tree.spectrum.safetensors").open("rb") as stream:
        coefficients = method.devoxelize(read_spectrum(stream), load_mesh(folder / "tree.glb"))
    points = [UsdGeom.Mesh(prim.GetChild("Surface")).GetPointsAttr() for prim in motions]
    assert [attribute.GetTimeSamples() for attribute in points] == [list(range(100))] * 3
    rest = np.array(points[0].Get())
    np.testing.assert_array_equal(np.array(points[2].Get()), rest)
    lean = coefficients[:, 0].real
    sizes = []
    for attribute in points:
        moved = np.stack([np.array(attribute.Get(code)) for code in range(100)]) - rest
        np.testing.assert_allclose(moved.mean(axis=0), lean, atol=1e-5)  # all lean alike
        spectrum = np.fft.fft(moved, axis=0)[1:16] / 100
        np.testing.assert_allclose(np.abs(spectrum), np.abs(coefficients.transpose(1, 0, 2)[1:]), atol=1e-5)
        sizes.append(moved)
    assert np.abs(sizes[0] - sizes[1]).max() > 0.01
    boxes = instancer.ComputeExtentAtTime(Usd.TimeCode(0), Usd.TimeCode(0))
    assert boxes[1][2] > 1.2 * np.ptp(sample.mesh.vertices[:, 2]) * 0.8


def test_blenders_timeline_shows_every_key_once(planted: pygltflib.GLTF2) -> None:
    duration_s, num_keys = blender_import.loop_of(planted.path)
    assert (duration_s, num_keys) == (pytest.approx(100 / 24), 101)
    assert blender_import.timeline(duration_s, num_keys) == (24, 99)


def test_blenders_camera_sees_the_whole_tree_and_no_mesh_out_of_view() -> None:
    tree, bone = (SimpleNamespace(type="MESH", visible_get=lambda seen=seen: seen) for seen in (True, False))
    assert blender_import.meshes_seen([tree, bone, SimpleNamespace(type="ARMATURE")]) == [tree]
    low, high = (-2.0, -3.0, 0.0), (2.0, 1.0, 10.0)
    place, aim = (np.array(point) for point in blender_import.viewpoint(low, high))
    corners = np.array(list(product(*zip(low, high, strict=True))))
    forward = (aim - place) / np.linalg.norm(aim - place)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    seen = (corners - place) @ np.stack([right, up, forward], axis=1)
    assert (seen[:, 2] > 0).all()
    assert np.abs(seen[:, 0] / seen[:, 2]).max() < 18 / 50  # 36 mm of film behind 50 mm, 16:9
    assert np.abs(seen[:, 1] / seen[:, 2]).max() < 18 / 50 * 9 / 16


PLAY = """
import sys
from pathlib import Path
import bpy
import numpy as np
from recipes import blender_import

if sys.argv[3] == "plain":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=sys.argv[1])
else:
    blender_import.main(Path(sys.argv[1]), None)
    sky = bpy.context.scene.world.node_tree.nodes["Background"].inputs[0].default_value
    assert np.allclose(sky[:3], blender_import.SKY)
(tree,) = [thing for thing in bpy.context.scene.objects if thing.type == "MESH"]
places = []
for frame in map(int, sys.argv[4:]):
    bpy.context.scene.frame_set(frame)
    moved = tree.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    places.append(np.empty(3 * len(moved.vertices), np.float32))
    moved.vertices.foreach_get("co", places[-1])
np.save(sys.argv[2], places)
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", ["plain", "recipe"])
def test_blender_plays_the_motion_that_the_file_tells(way: str, tmp_path: Path) -> None:
    """In a Python of its own, since Blender's wants an older numpy: BLENDER_PYTHON, after `pip install bpy`."""
    if "BLENDER_PYTHON" not in os.environ:
        pytest.skip("BLENDER_PYTHON names no Python with bpy, Blender as a module")
    mesh, frames = make_sample(3, "sapling").mesh, (0, 10, 37, 99)
    parts = np.random.default_rng(0).normal(0, 0.01, (mesh.num_vertices, 16, 6)).astype(np.float32)
    (tmp_path / "tree.glb").write_bytes(written(write_motion_glb, mesh, parts.view(np.complex64)))
    command = [os.environ["BLENDER_PYTHON"], "-c", PLAY, "tree.glb", "places.npy", way, *map(str, frames)]
    subprocess.run(command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, check=True, timeout=300)
    moved = np.load(tmp_path / "places.npy").reshape(len(frames), -1, 3) - mesh.vertices
    positions = read_morphs((tmp_path / "tree.glb").read_bytes())[list(frames)]
    np.testing.assert_allclose(moved, positions, atol=1e-5)


@pytest.mark.slow
def test_the_gallery_shows_each_file_or_why_it_was_refused(tree: Path, tmp_path: Path) -> None:
    trees = tmp_path / "trees"
    trees.mkdir()
    (trees / "sapling.glb").write_bytes(tree.read_bytes())
    (trees / "empty.obj").write_text("")
    (trees / "readme.txt").write_text("not a tree")
    assert gallery.main([str(trees), "-o", str(tmp_path / "out"), "--options", "--num-steps 1 --side-px 64"]) == 0
    page = (tmp_path / "out/index.html").read_text()
    assert "1 of 2 files move" in page
    assert "readme" not in page
    [picture] = re.findall(r'<img src="([^"]+)"', page)
    assert (tmp_path / "out" / picture).read_bytes().startswith(b"\x89PNG")
    assert re.search(r'class="error">[^<]*empty', page)


def test_a_gust_reaches_a_tree_as_late_as_its_way_is_long(rng: np.random.Generator) -> None:
    gusts = TravellingGusts(speed_m_s=6.0, wind_deg=30.0, period_s=4.0, variety=0.0)
    trees = plant_forest(rng, 9, num_frequencies=4, spacing_m=7.0, gusts=gusts)
    coefficients = (rng.normal(size=(5, 4, 3)) + 1j * rng.normal(size=(5, 4, 3))).astype(np.complex64)
    downwind = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    delays_s = [np.array(tree.position_m[:2]) @ downwind / 6.0 for tree in trees]
    assert np.ptp(delays_s) > 1
    for tree, delay_s in zip(trees, delays_s, strict=True):
        moved = loop_weights(4, 20, tree.phase_rad) @ loop_parts(coefficients, 20)
        later = np.stack(list(iter_motion(coefficients, np.arange(20) / 20 - delay_s / 4.0, 20)))
        np.testing.assert_allclose(moved.reshape(20, 5, 3), later, atol=1e-5)
    with pytest.raises(InputError, match="speed above 0"):
        plant_forest(rng, 4, num_frequencies=4, spacing_m=7.0, gusts=replace(gusts, speed_m_s=0.0))


def test_instanced_trees_share_motions_and_stand_where_the_others_do(planted: pygltflib.GLTF2) -> None:
    folder = planted.path.parent
    output = planted_as(folder / "instanced.glb", "--motions", "3")
    document = pygltflib.GLTF2().load(str(output))
    assert document.extensionsRequired == ["EXT_mesh_gpu_instancing"]
    assert len(document.nodes) == len(document.animations[0].channels) == 3
    named = [node.extensions["EXT_mesh_gpu_instancing"]["attributes"] for node in document.nodes]
    places = np.concatenate([accessor(document, one["TRANSLATION"]) for one in named])
    sizes = np.concatenate([accessor(document, one["SCALE"]) for one in named])
    require_same_places(np.column_stack([z_up(places), sizes[:, 0]]), planted)
    with (folder / "tree.spectrum.safetensors").open("rb") as stream:
        wind = read_spectrum(stream).wind
    angle = np.deg2rad(wind.direction_deg if wind else 0.0)
    ranges = [z_up(accessor(document, one["TRANSLATION"])) @ [np.cos(angle), np.sin(angle), 0] for one in named]
    assert all(a.max() <= b.min() for a, b in pairwise(ranges))
    keys = [accessor(document, sampler.output) for sampler in document.animations[0].samplers]
    assert not np.allclose(keys[0], keys[1])
    mesh = read_mesh(io.BytesIO(output.read_bytes()), file_type="glb")
    places = accessor(document, document.meshes[0].primitives[0].attributes.POSITION)
    assert mesh.num_vertices == COUNT * len(places)
    with pytest.raises(InputError, match="10 motions are asked for; 1 to 9"):
        planted_as(output, "--motions", "10")
