"""The command line takes one of the trees of a file."""

from pathlib import Path

import numpy as np
import pytest

from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.tensors.voxels import read_voxels
from dynamictree.mesh import join_meshes
from tests.commands.conftest import Run
from tests.formats.meshes import written
from tests.plant.stand import tree


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file of three trees in a row."""
    one = tree(6.0, num_cards=60)
    scene = join_meshes([one.with_vertices(one.vertices + np.float32([5 * i, 0, 0])) for i in range(3)])
    (path := tmp_path / "three.ply").write_bytes(written(write_ply, scene))
    return path


def test_one_tree_is_taken_and_a_part_of_it_stands_still(path: Path, tmp_path: Path, run: Run) -> None:
    """`--tree` with boxes: only what is left of that tree is voxelized, whatever stands still in the others."""
    still = ("--still-box", "-20,-20,3,20,20,9")

    def voxels(*options: object) -> np.ndarray:
        assert run("voxelize", path, "-o", tmp_path / "one", "--tree", 2, "--resolution", 64, *options).returncode == 0
        with (tmp_path / "one").open("rb") as stream:
            return read_voxels(stream).grid.centres_m

    whole, half = voxels(), voxels(*still)
    assert (np.abs(whole[:, 0] - 5) < 2.5).all()
    assert half[:, 2].max() < 3.3 < whole[:, 2].max()
    assert voxels(*still, "--moving-box", "-20,-20,3,20,20,9")[:, 2].max() < 3.3  # what is to stand still wins
    np.testing.assert_array_equal(voxels("--still-box", "-20,-20,-1,2,20,9"), whole)
