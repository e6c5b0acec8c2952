"""Trees stand up whichever way their file lies; where the shape leaves a doubt, there is a warning."""

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynamictree.dataset.sapling import grow_tree
from dynamictree.dataset.species import SPECIES
from dynamictree.formats.axes import up_rotation
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.upright import AXES, CERTAIN, judge_up_axis
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading


def trees(samples: Path | None) -> Iterator[TriangleMesh]:
    """One tree of each species, without names of materials, and the two of Sapling; +Z up."""
    for name, species in SPECIES.items():
        mesh = grow_tree(species, np.random.default_rng([11, len(name)])).mesh
        yield replace(mesh, materials=(), face_material=None)
    for path in sorted((samples / "sapling").glob("*.npz")) if samples else ():
        stored = np.load(path)
        yield TriangleMesh(vertices=stored["rest"].astype(np.float32), faces=stored["faces"].astype(np.int32))


def test_trees_stand_up_from_any_of_six_axes(samples: Path) -> None:
    verdicts = []
    for mesh in trees(samples):
        for axis in AXES:
            laid = mesh.with_vertices((mesh.vertices @ up_rotation(axis)).astype(np.float32))
            result = judge_up_axis(laid)
            verdicts.append((result.axis == axis, result.confidence >= CERTAIN))
    right, sure = np.array(verdicts).T
    assert right.mean() >= 0.98
    assert not (~right & sure).any()  # the rest is flagged


def test_names_of_materials_tell_wood_from_leaves() -> None:
    """A crown of the same outline at both ends of its pole stands on the end that is wood."""
    samples_of = grow_tree(SPECIES["shrub"], np.random.default_rng(0)).mesh
    bare = replace(samples_of, materials=(), face_material=None)
    assert judge_up_axis(samples_of).confidence > judge_up_axis(bare).confidence


def test_what_is_doubtful_is_said() -> None:
    ball = np.random.default_rng(0).normal(size=(60, 3))
    lines = [f"v {x} {y} {z}" for x, y, z in ball / np.linalg.norm(ball, axis=1, keepdims=True)]
    lines += [f"f {i} {i + 1} {i + 2}" for i in range(1, 58)]
    mesh = read_mesh(io.BytesIO("\n".join(lines).encode()), file_type="obj")
    assert "orientation-uncertain" in [warning.code for warning in mesh.warnings]
    assert mesh.source_up_confidence < CERTAIN
    stated = read_mesh(
        io.BytesIO("\n".join(lines).encode()), file_type="obj", reading=Reading(up_axis="+Z", height_m=3.0)
    )
    assert (stated.warnings, stated.source_up_confidence) == ((), 1.0)
    assert stated.height_m == pytest.approx(3.0, rel=1e-6)
