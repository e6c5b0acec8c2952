"""A skeleton that another program grew sways in the wind of the training data."""

from pathlib import Path

import numpy as np
import pytest

from dynamictree.spectrum import from_motion
from lab.dataset.tubes import own_rings
from lab.evaluation.foreign_skeleton import simulated, stems_of
from lab.evaluation.held_out_trees import SAPLING_WIND
from lab.evaluation.metrics import log_amplitude_agreement, root_share
from lab.evaluation.procedural_wind import Bones
from lab.evaluation.sapling_file import read_sapling

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
    assert correlation > 0.92
    assert rmse < 0.37
    assert root_share(motion, tree.mesh.vertices) < 0.01


def test_a_branch_of_fewer_bones_than_others_is_divided_evenly() -> None:
    """The add-on's presets mix them; a trunk of four bones, branches of four and of three."""
    counts, starts = (4, 4, 3), ((0, 0, 0), (0, 0, 2), (0, 0, 3))
    ways = ((0, 0, 1), (1, 0, 0), (0, 1, 0))
    head = np.concatenate(
        [start + np.arange(n)[:, None] * np.array(way) for n, start, way in zip(counts, starts, ways, strict=True)]
    )
    step = np.concatenate([np.arange(n) for n in counts])
    bones = Bones(
        head=head.astype(np.float32),
        tail=(head + np.repeat(ways, counts, axis=0)).astype(np.float32),
        parent=np.where(step > 0, np.arange(len(head)) - 1, np.repeat([-1, 1, 2], counts)).astype(np.int32),
        stem=np.repeat(np.arange(3), counts).astype(np.int32),
        step=step.astype(np.int32),
        radius=np.linspace(0.2, 0.1, len(head), dtype=np.float32),
        trunk=np.zeros(1, np.int32),
    )
    (trunk, branches), node = stems_of(bones)
    assert len(trunk.points) == 1
    np.testing.assert_allclose(branches.points[1, :, 1], np.linspace(0, 3, 5))
    np.testing.assert_allclose(branches.parent_ring, [2, 3], atol=0.02)
    position = np.concatenate([stems.points[own_rings(stems)] for stems in (trunk, branches)])
    assert np.linalg.norm(position[node] - bones.head, axis=1).max() < 0.5
