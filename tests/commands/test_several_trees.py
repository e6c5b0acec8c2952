"""The command line tells how many trees a file holds, and takes one of them."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.tensors.voxels import read_voxels
from dynamictree.mesh import joined
from tests.plant.stand import tree


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file of three trees in a row."""
    one = tree(6.0, num_cards=60)
    scene = joined([one.with_vertices(one.vertices + np.float32([5 * i, 0, 0])) for i in range(3)])
    with (path := tmp_path / "three.ply").open("wb") as stream:
        write_ply(scene, stream)
    return path


def test_the_command_line_counts_the_trees_and_takes_one(
    path: Path, tmp_path: Path, dynamictree: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert dynamictree("info", path, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert [entry["tree"] for entry in facts["trees"]] == [1, 2, 3]
    assert [entry["x_m"] for entry in facts["trees"]] == pytest.approx([0, 5, 10], abs=0.2)
    assert dynamictree("voxelize", path, "-o", tmp_path / "second", "--tree", 2, "--json") == 0
    assert json.loads(capsys.readouterr().out)["voxel_size_m"] == pytest.approx(6.0 * 0.99 / 125, rel=0.05)
    assert dynamictree("voxelize", path, "-o", tmp_path / "fourth", "--tree", 4) == 2
    assert "tree is 4, and the file holds 3 trees" in capsys.readouterr().err


def test_one_tree_is_taken_and_a_part_of_it_stands_still(
    path: Path, tmp_path: Path, dynamictree: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    """`--tree` with boxes: only what is left of that tree is voxelized, whatever stands still in the others."""

    def voxels(name: str, *options: object) -> np.ndarray:
        assert dynamictree("voxelize", path, "-o", tmp_path / name, "--tree", 2, *options) == 0
        with (tmp_path / name).open("rb") as stream:
            return read_voxels(stream).grid.centres_m

    whole = voxels("whole")
    assert (np.abs(whole[:, 0] - 5) < 2.5).all()
    half = voxels("half", "--still-box", "-20,-20,3,20,20,9")
    assert half[:, 2].max() < 3.3 < whole[:, 2].max()
    back = voxels("back", "--still-box", "-20,-20,3,20,20,9", "--moving-box", "-20,-20,3,20,20,9")
    assert back[:, 2].max() < 3.3  # what is to stand still wins
    others = voxels("others", "--still-box", "-20,-20,-1,2,20,9")
    np.testing.assert_array_equal(others, whole)
    assert dynamictree("voxelize", path, "-o", tmp_path / "x", "--tree", 2, "--still-box", "3,-9,-1,7,9,9") == 2
    assert "leave" in capsys.readouterr().err
