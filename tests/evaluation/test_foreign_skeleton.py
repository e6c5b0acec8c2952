"""A skeleton that another program grew sways in the wind of the training data."""

from pathlib import Path

import numpy as np
import pytest

from dynamictree.dataset.tubes import own_rings
from dynamictree.evaluation.foreign_skeleton import simulated, stems_of
from dynamictree.evaluation.held_out_trees import SAPLING_WIND
from dynamictree.evaluation.metrics import log_amplitude_agreement, root_share
from dynamictree.evaluation.sapling_file import read_sapling
from dynamictree.spectrum import from_motion

FILES = ("quaking_aspen_s0", "small_pine_s0")


@pytest.mark.parametrize("name", FILES)
def test_stems_lie_where_the_bones_do(samples: Path, name: str) -> None:
    bones = read_sapling(samples / "sapling" / f"{name}.npz").bones
    levels, node = stems_of(bones)
    assert len(np.unique(node)) == len(node)
    position = np.concatenate([stems.points[own_rings(stems)] for stems in levels])
    np.testing.assert_allclose(position[node], bones.head, atol=1e-6)
    bearers = [stems.parent[stems.first == 0].max(initial=-1) for stems in levels[1:]]
    assert all(bearer < len(below.points) for bearer, below in zip(bearers, levels[:-1], strict=True))


@pytest.mark.parametrize("name", FILES)
def test_an_add_on_s_tree_moves_much_as_in_its_own_wind(samples: Path, name: str) -> None:
    tree = read_sapling(samples / "sapling" / f"{name}.npz")
    motion = simulated(tree.bones, tree.mesh.vertices, tree.bone, SAPLING_WIND, 0)
    correlation, rmse = log_amplitude_agreement(motion, from_motion(tree.displacement), tree.mesh.height_m)
    assert correlation > 0.9
    assert rmse < 0.45
    assert root_share(motion, tree.mesh.vertices) < 0.01
