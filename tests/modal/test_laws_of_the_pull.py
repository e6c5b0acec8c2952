"""What a drag by displacement must obey in the bent shape."""

from itertools import pairwise

import numpy as np
import pytest

from dynamictree.modal.bone_chain import place_of, reach
from dynamictree.modal.force import Drag, contact_at_voxel
from dynamictree.modal.interactive_tree import ForceGroup, InteractiveTree, Locality
from dynamictree.modal.local_bend import own_omega
from dynamictree.modal.pull import carried_voxels
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.system import modal_system
from tests.modal.trees import fork

DT_S = 1 / 120
FALLOFF_M = 0.5


@pytest.fixture(scope="module")
def forked():
    spectrum, parts = fork(fineness=3)
    return InteractiveTree(modal_system(spectrum, mass_kg=30.0, damping_ratio=0.05)), parts


def pulled(tree, row, vector, *, num_frames=1, duration_s=None, start="held"):
    drag = Drag(at=contact_at_voxel(tree.system.grid, int(row)), displacement_m=vector, duration_s=duration_s)
    groups = group_forces([drag], falloff_m=FALLOFF_M)
    return respond(tree.system, groups, dt_s=DT_S, num_frames=num_frames, start=start, bent=tree)


def path_of(tree, row, answer):
    """Where a voxel is in the shape that is shown, [T, 3]."""
    return np.stack([frame[row] for frame in tree.voxels(answer, warp=True)]).astype(np.float64)


@pytest.mark.parametrize("vector", [(0.0, 0.3, 0.0), (0.0, 0.1, 0.2), (-0.1, 0.1, -0.3), (0.0, -0.6, 0.1)])
@pytest.mark.parametrize("share", [0.4, 1.0])
def test_the_grip_is_where_it_was_asked_to_be(forked, vector, share):
    tree, parts = forked
    row = parts["right"][int(share * (len(parts["right"]) - 1))]
    answer = pulled(tree, row, vector)
    path = path_of(tree, row, answer)[0]
    np.testing.assert_allclose(path, answer.reached[0].reached_m, atol=1e-4)
    assert np.linalg.norm(path - vector) < 0.05 * np.linalg.norm(vector)


def test_a_pull_along_a_stem_is_not_followed_and_says_so(forked):
    tree, parts = forked
    row = parts["stem"][-1]
    answer = pulled(tree, row, (0.0, 0.0, 0.5))
    path = path_of(tree, row, answer)[0]
    np.testing.assert_allclose(path, answer.reached[0].reached_m, atol=1e-4)
    assert answer.reached[0].reached_m[2] < 0.1


def test_a_target_beyond_the_branches_is_approached_without_folding_them(forked):
    tree, parts = forked
    row, vector = parts["stem"][6], (0.0, 0.3, 0.1)
    answer = pulled(tree, row, vector)
    assert answer.reached[0].beyond_m > 0.2
    assert np.linalg.norm(answer.bends[0][0], axis=1).max() < 0.75
    left = np.linalg.norm(path_of(tree, row, answer)[0] - vector) - answer.reached[0].beyond_m
    assert 0 <= left < 0.05 * np.linalg.norm(vector)


def test_the_other_branch_only_rides_on_the_stem(forked):
    tree, parts = forked
    answer = pulled(tree, parts["right"][-1], (0.0, 0.3, 0.0))
    (frame,) = tree.voxels(answer, warp=True)
    size = np.linalg.norm(frame, axis=1)
    assert size[parts["left"][-1]] < 0.3 * size[parts["right"][-1]]


def test_the_derivatives_of_a_place_that_two_branches_carry_are_those_of_its_reach(forked, rng):
    tree, parts = forked
    bones, row = tree.bones, int(parts["right"][-1])
    carriers = bones.bone_of_voxel[[row, int(parts["left"][-1])]]
    place = place_of(bones, tree.system.grid.centres_m[row], carriers, np.float32([0.7, 0.3]))
    turns, bends = rng.normal(size=(2, len(place), 3))
    _, by_turns, by_bends = reach(place, turns, bends)
    for which, derivative in ((0, by_turns), (1, by_bends)):
        for column in range(3 * len(place)):
            step = np.zeros((2, len(place), 3))
            step[which].flat[column] = 1e-6
            ahead = reach(place, turns + step[0], bends + step[1])[0]
            behind = reach(place, turns - step[0], bends - step[1])[0]
            np.testing.assert_allclose(derivative[:, column], (ahead - behind) / 2e-6, atol=1e-6)


def test_a_bone_carries_what_grows_on_it(forked):
    tree, parts = forked
    carried = carried_voxels(tree.bones)
    assert carried[0] == len(tree.system.grid)
    stem, tip = (tree.bones.bone_of_voxel[parts[name][-1]] for name in ("stem", "right"))
    assert carried[tip] < carried[stem]


def test_it_is_let_go_without_a_jump_in_position_or_velocity(forked):
    """The second difference of a free oscillator is bounded by ω² times its amplitude."""
    tree, parts = forked
    row, vector = parts["right"][-1], (0.0, 0.3, 0.1)
    answer = pulled(tree, row, vector, num_frames=60, duration_s=20 * DT_S)
    path = path_of(tree, row, answer)
    np.testing.assert_allclose(path[:21], np.broadcast_to(path[:1], path[:21].shape), atol=1e-5)
    acceleration = np.linalg.norm(np.diff(path, n=2, axis=0), axis=1) / DT_S**2
    omega = tree.system.omega.max()
    assert acceleration.max() < 1.5 * omega**2 * np.linalg.norm(path[0])
    velocity = np.linalg.norm(np.diff(path, axis=0), axis=1) / DT_S
    assert velocity[20] < 0.2 * velocity.max(), "it begins to move from rest"


def test_it_rings_at_the_branchs_own_frequency_and_dies_out(forked):
    tree, parts = forked
    row = int(parts["right"][-1])
    answer = pulled(tree, row, (0.0, 0.3, 0.0), num_frames=1200, duration_s=DT_S)
    path = path_of(tree, row, answer)[:, 1]
    crossings = np.flatnonzero(np.diff(np.sign(path)) != 0) * DT_S
    half_period = np.diff(crossings[:6]).mean()
    expected = np.pi / own_omega(tree.system, contact_at_voxel(tree.system.grid, row))
    assert half_period == pytest.approx(expected, rel=0.1)
    assert np.abs(path[-120:]).max() < 0.1 * np.abs(path).max()


def test_a_pull_goes_on_over_two_calls(forked):
    tree, parts = forked
    row, vector = int(parts["right"][-1]), (0.0, 0.3, 0.0)
    whole = pulled(tree, row, vector, num_frames=40, duration_s=10 * DT_S, start="rest")
    first = pulled(tree, row, vector, num_frames=20, duration_s=10 * DT_S, start="rest")
    group = ForceGroup(locality=Locality(seed_voxel=row, falloff_m=FALLOFF_M))
    rest = respond(
        tree.system, [group], dt_s=DT_S, num_frames=20, start=first.final, start_bends=first.final_bends, bent=tree
    )
    np.testing.assert_allclose(np.concatenate([first.bends[0], rest.bends[0]]), whole.bends[0], atol=1e-12)
    np.testing.assert_allclose(np.concatenate([first.q, rest.q]), whole.q, atol=1e-12)


def test_a_target_moves_its_answer_continuously(forked):
    """A pointer that moves by a hundredth moves every bend by little: the hand feels no snap."""
    tree, parts = forked
    row = parts["right"][-1]
    bends = [pulled(tree, row, (0.0, y, 0.1)).bends[0][0] for y in np.linspace(0.02, 0.6, 30)]
    assert max(np.abs(b - a).max() for a, b in pairwise(bends)) < 0.1
