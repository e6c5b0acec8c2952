"""What does not look like a plant is doubted; trees are not, low-poly ones included."""

import numpy as np
import pytest
import trimesh

from dynamictree.commands.input_files import load_mesh
from dynamictree.plant.plausibility import doubt_mesh
from dynamictree.requests import Reading
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from tests.formats.meshes import read

GREEN, GREY = (60, 140, 50, 255), (150, 150, 150, 255)


def codes(parts: list[trimesh.Trimesh], color: tuple[int, int, int, int]) -> list[str]:
    whole = trimesh.util.concatenate(parts)
    whole.visual = trimesh.visual.ColorVisuals(whole, vertex_colors=np.tile(np.uint8(color), (len(whole.vertices), 1)))
    mesh = read(whole.export(file_type="ply"), "ply", reading=Reading(up_axis="+Z", unit_m=1.0))
    return [warning.code for warning in mesh.warnings]


def placed(part: trimesh.Trimesh, z: float, x: float = 0.0) -> trimesh.Trimesh:
    part.apply_translation((x, 0, z))
    return part


def cones() -> list[trimesh.Trimesh]:
    """A low-poly conifer, or a lamp."""
    shades = [placed(trimesh.creation.cone(1.2 - 0.3 * i, 1.5, sections=8), 1 + 0.8 * i) for i in range(3)]
    return [placed(trimesh.creation.cylinder(0.15, 1.2, sections=8), 0.6), *shades]


def chair() -> list[trimesh.Trimesh]:
    boxes = ((0.05, 0.05, 0.9), 0.45, -0.3), ((0.05, 0.05, 0.9), 0.45, 0.3), ((0.7, 0.5, 0.05), 0.45, 0.0)
    return [placed(trimesh.creation.box(size), z, x) for size, z, x in (*boxes, ((0.7, 0.05, 0.6), 0.8, 0.0))]


@pytest.mark.parametrize("parts", [cones, chair])
def test_turned_bodies_and_boxes_are_doubted_where_nothing_is_green(parts: object) -> None:
    assert "not-like-a-plant" in codes(parts(), GREY)
    assert "not-like-a-plant" not in codes(parts(), GREEN)


@pytest.mark.parametrize("name", ["conical-conifer", "spire-conifer", "columnar", "palm", "bare-winter"])
def test_trees_without_colours_are_not_doubted(name: str) -> None:
    assert doubt_mesh(grow_tree(SPECIES[name], np.random.default_rng([5, len(name)])).mesh) == ()


def test_artists_trees_are_not_doubted(samples) -> None:
    for name in ("mesh/tree-lime.glb", "mesh/quaternius_common_tree/CommonTree_2.obj"):
        assert "not-like-a-plant" not in [warning.code for warning in load_mesh(samples / name).warnings]
    ball = load_mesh(samples / "animated/AnimatedMorphSphere.glb")
    assert "not-like-a-plant" in [warning.code for warning in ball.warnings]
