from pathlib import Path

import numpy as np
import pytest

from dynamictree.errors import FormatError, InputError
from lab.evaluation.sapling_file import read_sapling, sapling_files

STILL, SWAYING = 0, 1
NUM_WOOD = 8


def test_a_folder_without_trees_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no \.npz"):
        sapling_files(tmp_path)


def test_a_file_without_a_skeleton_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "bush.npz", vertices=np.zeros((2, 3, 3)), faces=np.zeros((1, 3)))
    with pytest.raises(FormatError, match="lacks rest, part"):
        read_sapling(tmp_path / "bush.npz")


@pytest.fixture(scope="module")
def two_stems() -> dict[str, np.ndarray]:
    """Two stems of one bone each; one sways. A leaf of the swaying stem is nearer to the still one."""
    head = np.array([[0, 0, 0], [1, 0, 0]], np.float32)
    ring = np.array([[0.1, 0, 0], [0, 0.1, 0], [-0.1, 0, 0], [0, -0.1, 0]], np.float32)
    leaf = np.array([[0.3, 0, 0.4], [0.3, 0, 0.6], [0.4, 0, 0.5]], np.float32)
    angle = 0.1 * np.sin(np.arange(10))
    mats = np.tile(np.eye(4, dtype=np.float32), (len(angle), 2, 1, 1))
    mats[:, SWAYING, :3, :3] = [[[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]] for a in angle]
    mats[:, SWAYING, :3, 3] = head[SWAYING] - mats[:, SWAYING, :3, :3] @ head[SWAYING]
    rest = np.concatenate([head[0] + ring, head[1] + ring, leaf])
    true_bone = np.repeat([STILL, SWAYING, SWAYING], [4, 4, 3]).astype(np.int32)
    of_vertex = mats[:, true_bone]  # [T, N, 4, 4]
    moved = np.einsum("tnij,nj->tni", of_vertex[..., :3, :3], rest) + of_vertex[..., :3, 3]
    return {
        "vertices": moved.astype(np.float32),
        "rest": rest,
        "faces": np.array([[0, 1, 2], [4, 5, 6], [8, 9, 10]], np.int32),
        "part": np.repeat([0, 1], [NUM_WOOD, len(leaf)]).astype(np.uint8),
        "comp": np.repeat([0, 1, 0], [4, 4, 3]).astype(np.int32),
        "bone_head": head,
        "bone_tail": head + np.array([0, 0, 1], np.float32),
        "bone_parent": np.array([-1, -1], np.int32),
        "bone_names": np.array(["bone000.000", "bone001.000"]),
        "bone_mats": mats,
        "bone": true_bone,
    }


def without(arrays: dict[str, np.ndarray], *names: str) -> dict[str, np.ndarray]:
    return {name: array for name, array in arrays.items() if name not in names}


def test_the_bone_of_each_vertex_is_read_where_the_file_has_it(
    two_stems: dict[str, np.ndarray], tmp_path: Path
) -> None:
    exchanged = 1 - two_stems["bone"]  # what neither the motion nor the distance gives
    np.savez(tmp_path / "tree.npz", **(two_stems | {"bone": exchanged}))
    np.testing.assert_array_equal(read_sapling(tmp_path / "tree.npz").bone, exchanged)


def test_a_leaf_goes_with_the_bone_that_moves_as_it_does(two_stems: dict[str, np.ndarray], tmp_path: Path) -> None:
    np.savez(tmp_path / "tree.npz", **without(two_stems, "bone"))
    np.testing.assert_array_equal(read_sapling(tmp_path / "tree.npz").bone, two_stems["bone"])


def test_a_leaf_goes_with_the_nearest_bone_where_the_file_has_no_motion_of_bones(
    two_stems: dict[str, np.ndarray], tmp_path: Path
) -> None:
    np.savez(tmp_path / "tree.npz", **without(two_stems, "bone", "bone_mats"))
    bone = read_sapling(tmp_path / "tree.npz").bone
    np.testing.assert_array_equal(bone[:NUM_WOOD], two_stems["bone"][:NUM_WOOD])
    assert (bone[NUM_WOOD:] == STILL).all()
