"""What holds from the forces to the voxels."""

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.modal.force import Drag, Impulse, WindField, contact_at_voxel
from dynamictree.modal.interactive_tree import ForceGroup, Locality
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.step import State
from tests.modal.trees import rigged_fork

DT_S = 1 / 60


def voxels(tree, answer):
    """Every frame at once, [T, V, 3]."""
    return np.stack(list(tree.voxels(answer)))


@pytest.fixture(scope="module")
def tree():
    pulled, _, parts = rigged_fork()
    return pulled, parts


def knock(tree, row, vector=(0.0, 2.0, 0.0)):
    return Impulse(at=contact_at_voxel(tree.system.grid, int(row)), impulse_n_s=vector)


def test_forces_at_one_voxel_are_one_group_and_wind_is_the_whole_trees(tree):
    tree, parts = tree
    right, left = int(parts["right"][-1]), int(parts["left"][-1])
    forces = [knock(tree, right), knock(tree, left), WindField(velocity_m_s=np.ones((1, 3))), knock(tree, right)]
    groups = group_forces(forces, falloff_m=0.5)
    assert [group.locality and group.locality.seed_voxel for group in groups] == [right, left, None]
    assert [len(group.forces) for group in groups] == [2, 1, 1]


def test_the_poked_branch_swings_and_the_other_barely(tree):
    tree, parts = tree
    groups = group_forces([knock(tree, parts["right"][-1])], falloff_m=0.5)
    answer = respond(tree.system, groups, dt_s=DT_S, num_frames=60)
    swing = np.abs(voxels(tree, answer)).max(axis=(0, 2))
    assert swing[parts["left"][5:]].max() < 0.05 * swing[parts["right"][-1]]


def test_small_groups_add_up_in_space(tree):
    tree, parts = tree
    forces = [knock(tree, row, (0.0, 0.02, 0.0)) for row in (parts["right"][-1], parts["left"][-2])]
    both, *apart = [
        voxels(tree, respond(tree.system, group_forces(chosen, falloff_m=0.5), dt_s=DT_S, num_frames=20))
        for chosen in (forces, forces[:1], forces[1:])
    ]
    np.testing.assert_allclose(both, apart[0] + apart[1], atol=0.005 * np.abs(both).max())


def test_a_call_goes_on_where_the_last_one_ended(tree):
    tree, parts = tree
    system = tree.system
    pull = Drag(at=contact_at_voxel(system.grid, int(parts["right"][-1])), force_n=(0.0, 3.0, 0.0), duration_s=0.5)
    whole = respond(system, group_forces([pull], falloff_m=0.5), dt_s=DT_S, num_frames=60)
    first = respond(system, group_forces([pull], falloff_m=0.5), dt_s=DT_S, num_frames=20)
    later = Drag(at=pull.at, force_n=pull.force_n, start_s=-20 * DT_S, duration_s=0.5)
    second = respond(system, group_forces([later], falloff_m=0.5), dt_s=DT_S, num_frames=40, start=first.final)
    np.testing.assert_allclose(np.concatenate([first.q, second.q]), whole.q, atol=1e-12)


def test_an_equilibrium_start_does_not_move_until_it_is_released(tree):
    tree, parts = tree
    pull = Drag(at=contact_at_voxel(tree.system.grid, int(parts["right"][-1])), force_n=(0.0, 3.0, 0.0), duration_s=0.5)
    answer = respond(tree.system, group_forces([pull], falloff_m=0.5), dt_s=DT_S, num_frames=60, start="held")
    np.testing.assert_allclose(answer.q[:31], np.broadcast_to(answer.q[:1], answer.q[:31].shape), atol=1e-12)
    assert np.abs(answer.q[35] - answer.q[0]).max() > 1e-3


def test_daviss_start_replaces_the_one_force(tree):
    tree, parts = tree
    groups = group_forces([knock(tree, parts["right"][-1])], falloff_m=0.5)
    once, twice = (
        respond(tree.system, group, dt_s=DT_S, num_frames=10, start="davis")
        for group in (groups, group_forces([knock(tree, parts["right"][-1], (0.0, 4.0, 0.0))], falloff_m=0.5))
    )
    np.testing.assert_allclose(once.q, twice.q)  # a direction, not a strength
    assert np.abs(once.q[1]).max() > 0
    forces = [knock(tree, parts["right"][-1])] * 2
    with pytest.raises(InputError, match="one impulse or drag"):
        respond(tree.system, group_forces(forces, falloff_m=0.5), dt_s=DT_S, num_frames=5, start="davis")


def test_a_state_of_other_groups_is_refused(tree):
    tree, _ = tree
    groups = (ForceGroup(locality=Locality(seed_voxel=0, falloff_m=1.0)),)
    with pytest.raises(InputError, match="groups of"):
        respond(tree.system, groups, dt_s=DT_S, num_frames=5, start=State.at_rest(2, tree.system.num_modes))
