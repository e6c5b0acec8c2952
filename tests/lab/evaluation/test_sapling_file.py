import numpy as np
import pytest

from dynamictree.errors import FormatError, InputError
from lab.evaluation.held_out_trees import read_sapling, sapling_files


def test_a_folder_without_trees_is_refused(tmp_path) -> None:
    with pytest.raises(InputError, match=r"no \.npz"):
        sapling_files(tmp_path)


def test_a_file_without_its_rest_pose_is_refused(tmp_path) -> None:
    np.savez(tmp_path / "bush.npz", vertices=np.zeros((2, 3, 3)), faces=np.zeros((1, 3)))
    with pytest.raises(FormatError, match="lacks rest"):
        read_sapling(tmp_path / "bush.npz")
