"""Trees stand up whichever way their file lies; where the shape leaves a doubt, there is a warning."""

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dynamictree.axis_names import AXES
from dynamictree.formats.source_file import read_capture
from dynamictree.mesh import TriangleMesh, join_meshes
from dynamictree.plant.upright import CERTAIN, judge_up_axis
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from tests.formats.meshes import read


def trees(samples: Path | None) -> Iterator[TriangleMesh]:
    """One tree of each species, without names of materials, and the two of Sapling; +Z up."""
    for name, species in SPECIES.items():
        mesh = grow_tree(species, np.random.default_rng([11, len(name)])).mesh
        yield replace(mesh, look=replace(mesh.look, materials=(), face_material=None))
    for path in sorted((samples / "sapling").glob("*.npz")) if samples else ():
        stored = np.load(path)
        yield TriangleMesh(vertices=stored["rest"].astype(np.float32), faces=stored["faces"].astype(np.int32))


def test_trees_stand_up_from_any_of_six_axes(samples) -> None:
    verdicts = []
    for number, mesh in enumerate(trees(samples)):
        for axis in AXES[number % 2 :: 2]:  # `benchmarks upright_trees` takes all six of each
            laid = mesh.with_vertices((mesh.vertices @ up_rotation(axis)).astype(np.float32))
            result = judge_up_axis(laid)
            verdicts.append((result.axis == axis, result.confidence >= CERTAIN))
    right, sure = np.array(verdicts).T
    assert right.mean() >= 0.98
    assert not (~right & sure).any()  # the rest is flagged


def test_names_of_materials_tell_wood_from_leaves() -> None:
    """A crown of the same outline at both ends of its pole stands on the end that is wood."""
    samples_of = grow_tree(SPECIES["shrub"], np.random.default_rng(0)).mesh
    bare = replace(samples_of, look=replace(samples_of.look, materials=(), face_material=None))
    assert judge_up_axis(samples_of).confidence > judge_up_axis(bare).confidence


def test_what_is_doubtful_is_said() -> None:
    ball = np.random.default_rng(0).normal(size=(60, 3))
    lines = [f"v {x} {0.8 * y} {z}" for x, y, z in ball / np.linalg.norm(ball, axis=1, keepdims=True)]
    lines += [f"f {i} {i + 1} {i + 2}" for i in range(1, 58)]
    mesh = read("\n".join(lines).encode(), "obj")
    assert "orientation-uncertain" in [warning.code for warning in mesh.warnings]
    assert (mesh.source.up_axis, mesh.source.up_confidence < CERTAIN) == ("+Y", True)  # usual: ferns are flat, too
    stated = read("\n".join(lines).encode(), "obj", reading=Reading(up_axis="+Z", height_m=3.0))
    assert (stated.warnings, stated.source.up_confidence) == ((), 1.0)
    assert stated.height_m == pytest.approx(3.0, rel=1e-6)


def ball(middle: tuple[float, float, float], radius: float) -> TriangleMesh:
    return TriangleMesh.from_trimesh(trimesh.creation.icosphere(1, radius).apply_translation(middle))


@pytest.fixture(scope="module")
def pine() -> TriangleMesh:
    mesh = grow_tree(SPECIES["pine"], np.random.default_rng([11, 4])).mesh
    return TriangleMesh(vertices=mesh.vertices, faces=mesh.faces)


@pytest.mark.parametrize("axis", ["+X", "-Y", "-Z"])
def test_a_tree_in_a_scene_stands_up_from_any_axis(axis: str) -> None:
    """A ball on a pole with stones that lie wider than its crown: the plant alone says what is up."""
    pole = TriangleMesh.from_trimesh(trimesh.creation.cylinder(0.12, 2).apply_translation((0, 0, 1)))
    stones = [ball((x, y, 0.1), 0.15) for x, y in ((2.0, 0.3), (-1.5, 1.2), (0.4, -1.8), (1.2, 1.9))]
    scene = join_meshes([pole, ball((0, 0, 2.4), 0.7), *stones])
    assert judge_up_axis(scene.with_vertices((scene.vertices @ up_rotation(axis)).astype(np.float32))).axis == axis


def doubts_of_scan(surface: trimesh.Trimesh, up_axis: str | None = None) -> list[str]:
    points = trimesh.sample.sample_surface(surface, 4000, seed=0)[0]
    text = "\n".join(f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in points)
    capture = read_capture(io.BytesIO(text.encode()), file_type="txt", reading=Reading(up_axis=up_axis))
    return [warning.message for warning in capture.warnings if warning.code == "orientation-uncertain"]


@pytest.mark.parametrize("axis", ["+X", "+Y", "+Z"])
def test_a_file_whose_axis_its_shape_denies_is_flagged_with_the_other(pine: TriangleMesh, axis: str) -> None:
    """glTF is +Y up by its specification, scans are +Z by habit: exporters and scanners differ."""
    laid = (pine.vertices @ up_rotation(axis)).astype(np.float32)
    surface = trimesh.Trimesh(laid, pine.faces, process=False)
    mesh = read(surface.export(file_type="glb"), "glb")
    doubts = [warning.message for warning in mesh.warnings if warning.code == "orientation-uncertain"]
    assert [f"set up_axis to {axis} " in message for message in doubts] == ([] if axis == "+Y" else [True])
    assert [f"set up_axis to {axis} " in message for message in doubts_of_scan(surface)] == (
        [] if axis == "+Z" else [True]
    )
    assert not doubts_of_scan(surface, up_axis="+X")


@pytest.mark.parametrize("axis", ["+X", "+Y", "+Z"])
@pytest.mark.parametrize(("species", "seed"), [("round-broadleaf", 1), ("spreading-broadleaf", 3)])
def test_a_scanned_plant_that_lies_is_doubted_though_no_axis_is_sure(species: str, seed: int, axis: str) -> None:
    tree = grow_tree(SPECIES[species], np.random.default_rng(seed)).mesh
    laid = trimesh.Trimesh(tree.vertices @ up_rotation(axis), tree.faces, process=False)
    assert ["rather lies" in message for message in doubts_of_scan(laid)] == ([] if axis == "+Z" else [True])


@pytest.mark.parametrize(("up_axis", "doubted"), [("+Z", True), ("+Y", False)])
def test_several_trees_that_lie_in_a_gltf_are_flagged(up_axis: str, doubted: bool) -> None:
    whole = grow_tree(SPECIES["round-broadleaf"], np.random.default_rng(1)).mesh
    tree = TriangleMesh(vertices=whole.vertices, faces=whole.faces)
    plot = join_meshes([tree, tree.with_vertices(tree.vertices + np.float32([3 * tree.height_m, 0, 0]))])
    laid = trimesh.Trimesh(plot.vertices @ (up_rotation(up_axis)), plot.faces, process=False)
    mesh = read(laid.export(file_type="glb"), "glb")
    messages = [warning.message for warning in mesh.warnings if warning.code == "orientation-uncertain"]
    assert ["set up_axis to +Z" in message for message in messages] == [True] * doubted
