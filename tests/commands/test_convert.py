"""`dynamictree convert`: what is read back is what was written."""

from pathlib import Path

import numpy as np
import pytest

from dynamictree.commands.input_files import load_capture, load_mesh
from dynamictree.requests import Reading
from tests.commands.conftest import Run, assert_refused

TEXTURED = b"mtllib t.mtl\nv 0 0 0\nv 0.5 0 0\nv 0 0 2\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl bark\nf 1/1 2/2 3/3\n"


@pytest.fixture
def mesh_path(tmp_path: Path) -> Path:
    path = tmp_path / "t.obj"
    path.write_bytes(TEXTURED)
    path.with_suffix(".mtl").write_text("newmtl bark\nKd 0.5 0.25 0.125\n")
    return path


@pytest.mark.parametrize(("ending", "up_axis"), [("glb", "+Y"), ("obj", "+Z"), ("ply", "+Z")])
def test_a_mesh_keeps_its_triangles_and_its_size(run, mesh_path, tmp_path, ending, up_axis) -> None:
    written = tmp_path / "out" / f"tree.{ending}"
    assert run("convert", mesh_path, written, "--up-axis", "z").returncode == 0
    before, after = load_mesh(mesh_path, Reading(up_axis="+Z")), load_mesh(written, Reading(up_axis=up_axis))
    np.testing.assert_allclose(after.vertices, before.vertices, atol=1e-6)
    np.testing.assert_array_equal(after.faces, before.faces)
    if ending != "ply":  # PLY has no materials
        np.testing.assert_allclose(after.look.materials[0].base_color, before.look.materials[0].base_color, atol=1e-3)


@pytest.mark.parametrize("ending", ["ply", "splat", "spz", "sog", "glb"])
def test_a_cloud_keeps_its_gaussians(run: Run, tmp_path: Path, ending: str) -> None:
    rng = np.random.default_rng(3)
    scan = tmp_path / "scan.xyz"
    np.savetxt(scan, rng.uniform(0, 2, (300, 3)) * (0.2, 0.2, 1))
    written = tmp_path / f"tree.{ending}"
    assert run("convert", scan, written).returncode == 0
    before = load_capture(scan).cloud
    up_axis = {"spz": "+Y", "glb": "+Y", "sog": "-Y"}.get(ending, "+Z")
    after = load_capture(written, Reading(up_axis=up_axis, unit_m=1)).cloud
    assert before.num_gaussians == after.num_gaussians
    np.testing.assert_allclose(np.sort(after.means, axis=0), np.sort(before.means, axis=0), atol=2e-3)


def test_a_mesh_cannot_become_a_splat(run: Run, mesh_path: Path, tmp_path: Path) -> None:
    written = tmp_path / "x.spz"
    assert_refused(run("convert", mesh_path, written), "choose from .glb, .obj, .ply", written, at_once=False)
