"""What a drag by displacement must obey in the bent shape."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.modal.force import Drag, contact_at_voxel
from dynamictree.modal.interactive_tree import ForceGroup, InteractiveTree, Locality
from dynamictree.modal.pull import _forward, equilibrium, grip_of
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.system import displacement, modal_system
from dynamictree.rig.pose import carried, poses
from dynamictree.rig.rig import rig_of
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.voxelize import voxelize
from lab.dataset.sample import make_sample, voxel_spectrum

DT_S = 1 / 120
FALLOFF_M = 0.5
ANSWERS = Path(__file__).with_name("pulls.json")


def pulled(tree, row, vector, *, num_frames=1, duration_s=None, start="held", at=None):
    at = at or contact_at_voxel(tree.system.grid, int(row))
    drag = Drag(at=at, displacement_m=vector, duration_s=duration_s)
    groups = group_forces([drag], falloff_m=FALLOFF_M)
    return respond(tree.system, groups, dt_s=DT_S, num_frames=num_frames, start=start, tree=tree)


def path_of(tree, row, answer):
    """Where a voxel is in the shape that is shown, [T, 3]."""
    return np.stack([frame[row] for frame in tree.voxels(answer)]).astype(np.float64)


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
    answer = pulled(tree, parts["stem"][-1], (0.0, 0.0, 0.5))
    path = path_of(tree, parts["stem"][-1], answer)[0]
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


def test_of_all_bends_that_bring_the_point_there_the_answer_has_the_least_energy(rng):
    segments, give = rng.normal(size=(6, 3)) + np.array([0, 0, 2]), np.geomspace(1, 0.05, 6)
    target = np.array([2.0, -1.0, -1.5])
    there = {"type": "eq", "fun": lambda x: _forward(segments, give, x.reshape(6, 3))[2] - target}
    least = minimize(lambda x: _forward(segments, give, x.reshape(6, 3))[3], np.full(18, 0.1), constraints=there)
    pull = equilibrium(grip_of(segments, give), target, np.zeros((6, 3)))
    np.testing.assert_allclose(pull.reached_m, target, atol=1e-4)
    np.testing.assert_allclose(pull.bend.ravel(), least.x, atol=0.01)


@pytest.mark.parametrize("case", json.loads(ANSWERS.read_text()), ids=lambda case: case["name"])
def test_the_answers_are_those_that_the_page_must_give(case):
    """tests/browser/page.test.mjs reads the same file."""
    grip = grip_of(np.array(case["segments_m"]), np.array(case["give"]))
    pull = equilibrium(grip, np.array(case["target_m"]), np.zeros_like(grip.segments_m))
    np.testing.assert_allclose(pull.bend, case["bend"], atol=1e-5)
    np.testing.assert_allclose(pull.reached_m, case["reached_m"], atol=1e-5)


def test_a_joint_carries_what_grows_on_it(forked):
    tree, parts = forked
    joints = tree.joints
    stem, tip = (joints.of_voxel[parts[name][-1]] for name in ("stem", "right"))
    assert joints.num_carried[joints.chain(int(parts["right"][-1]))[-1]] > 0.9 * len(tree.system.grid)
    assert joints.num_carried[tip] < joints.num_carried[stem]
    compliance = joints.compliance * joints.num_carried**2
    assert 2 * compliance[stem] < compliance[tip]
    assert not set(joints.chain(int(parts["left"][-1]))) & set(joints.of_voxel[parts["right"][6:]].tolist())


def test_a_pulled_pole_bends_evenly_and_not_at_the_ground(forked):
    tree, parts = forked
    turns = np.linalg.norm(pulled(tree, parts["stem"][-1], (0.0, 0.4, 0.0)).bends[0][0], axis=1)
    assert len(turns) > 10
    assert turns[-1] < 0.15 * turns.sum()
    lower, upper = turns[len(turns) // 2 :].sum(), turns[: len(turns) // 2].sum()
    assert 0.5 < lower / upper < 2


def test_a_vertex_itself_is_pulled_and_edges_keep_their_lengths():
    """A grown tree, and a crown that is one surface, whose other branches tear when one of their bones bends alone."""
    sample = make_sample(3, "sapling")
    spectrum = voxel_spectrum(sample)[1]
    for mesh, sway, median, most in ((sample.mesh, spectrum, 0.01, 0.01), (*ball_on_a_pole(), 0.06, 0.15)):
        tree = InteractiveTree(modal_system(sway), rig_of(mesh, sway), mesh)
        edges = edges_of(mesh.faces)
        rest = np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1)
        height, rng, errors, growths = mesh.height_m, np.random.default_rng(0), [], []
        high = np.flatnonzero(mesh.vertices[:, 2] > mesh.vertices[:, 2].min() + 0.4 * height)
        for vertex in rng.choice(high, 20, replace=False):
            x, y = 0.1 * height * np.array([np.cos(vertex), np.sin(vertex)])
            answer = pulled(tree, 0, (x, y, 0.0), at=tree.contact_at_vertex(mesh.vertices, int(vertex)))
            (moved,) = tree.bent(answer, mesh.vertices, tree.rig.vertices)
            np.testing.assert_allclose(moved[vertex], answer.reached[0].reached_m, atol=1e-4 * height)
            if answer.reached[0].beyond_m == 0:
                errors.append(np.linalg.norm(moved[vertex] - [x, y, 0]) / (0.1 * height))
            long = np.linalg.norm(np.diff((mesh.vertices + moved)[edges], axis=1)[:, 0], axis=1)
            growths.append(np.percentile(np.abs(long / rest - 1)[rest > 1e-4], 99))
        assert len(errors) > 10
        assert np.percentile(errors, 95) < 0.01
        assert (np.percentile(growths, [50, 95]) < [median, most]).all()


def ball_on_a_pole():
    """One surface of 3 m with a crown, swaying."""
    turn, up = np.meshgrid(np.linspace(0, 2 * np.pi, 24, endpoint=False), np.linspace(0, 1, 40), indexing="ij")
    radius = np.where(up < 0.4, 0.06, 0.06 + 0.8 * np.sqrt(np.clip(1 - ((up - 0.7) / 0.31) ** 2, 0, 1)))
    places = np.stack([radius * np.cos(turn), radius * np.sin(turn), 3 * up], axis=2)
    corner = np.arange(24 * 40).reshape(24, 40)
    beside = np.roll(corner, -1, axis=0)
    quads = [(corner[:, :-1], beside[:, :-1], beside[:, 1:]), (corner[:, :-1], beside[:, 1:], corner[:, 1:])]
    faces = np.concatenate([np.stack(three, axis=2).reshape(-1, 3) for three in quads])
    mesh = TriangleMesh(vertices=places.reshape(-1, 3).astype(np.float32), faces=faces.astype(np.int32))
    grid = voxelize(mesh, 64).grid
    coefficients = np.zeros((len(grid), 2, 3), np.complex64)
    coefficients[:, 1, 0] = 0.02 * grid.centres_m[:, 2] ** 2
    return mesh, SparseVoxelSpectrum(grid=grid, coefficients=coefficients)


@pytest.mark.parametrize("local", [True, False])
def test_small_pushes_are_those_of_the_modes(forked, local):
    """To first order in the forces the bones follow the modes, also where the push fades towards the root."""
    tree, parts = forked
    branch = Locality(seed_voxel=int(parts["right"][-1]), falloff_m=FALLOFF_M)
    group = ForceGroup(locality=branch if local else None)
    answer = respond(tree.system, [group], dt_s=DT_S, num_frames=1)
    q = 1e-3 * np.exp(1j * np.arange(tree.system.num_modes))[None, None]
    answer = replace(answer, q=q)
    plain = tree.weights([group])[0][:, None] * displacement(tree.system.shapes, q[0])[0]
    bent = next(tree.voxels(answer))
    tip = parts["right"][-3:]
    np.testing.assert_allclose(bent[tip], plain[tip], atol=0.15 * np.linalg.norm(plain[tip[-1]]))
    if local:
        others, branch = (np.linalg.norm(bent[parts[name]], axis=1).max() for name in ("left", "right"))
        assert others < branch


def test_joints_bend_in_the_shape_that_forces_give(forked, rng):
    tree, _ = forked
    skeleton, joints = tree.bones.skeleton, tree.joints
    theta = 0.2 * rng.normal(size=(1, len(skeleton), 3)).astype(np.float32)
    stance, bends = poses(skeleton, theta), np.zeros((len(joints.parent), 3))
    joint = int(joints.parent[-1])
    bends[joint] = [0.3, -0.2, 0.5]
    points = tree.system.grid.centres_m
    before = points + carried(skeleton, stance, 0, points, tree.bones.voxels)
    after = points + carried(skeleton, joints.bent(stance, bends), 0, points, tree.bones.voxels)
    beyond = np.array([joint in joints.chain(v) for v in range(len(points))])
    whole = beyond & np.isin(tree.bones.voxels.rows, np.flatnonzero(joints.of_bone > joint)).any(axis=1)
    turn, at = Rotation.from_rotvec(bends[joint]), joints.place_m[joint]
    far = beyond & (tree.bones.voxels.shares.max(axis=1) == 1) & whole
    assert far.sum() > 10
    np.testing.assert_allclose(after[far], turn.apply(before[far] - at) + at, atol=1e-5)
    np.testing.assert_allclose(after[~beyond], before[~beyond], atol=0.05)


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


def test_each_joint_rings_at_its_own_frequency_and_dies_out(forked):
    tree, parts = forked
    row = int(parts["right"][-1])
    bends = pulled(tree, row, (0.0, 0.3, 0.0), num_frames=1200, duration_s=DT_S).bends[0]
    omega = tree.joints.omega(tree.system, tree.joints.chain(row))
    assert omega[0] > 1.05 * omega[-1], "a tip rings faster than the foot of the stem"
    for joint in (0, len(omega) // 2, -1):
        turn = bends[:, joint, np.abs(bends[0, joint]).argmax()]
        crossings = np.flatnonzero(np.diff(np.sign(turn)) != 0) * DT_S
        half_period = np.diff(crossings[:6]).mean()
        assert half_period == pytest.approx(np.pi / (omega[joint] * np.sqrt(1 - 0.05**2)), rel=0.02)
    assert np.abs(bends[-120:]).max() < 0.1 * np.abs(bends).max()


def test_a_pull_goes_on_over_two_calls(forked):
    tree, parts = forked
    row, vector = int(parts["right"][-1]), (0.0, 0.3, 0.0)
    whole = pulled(tree, row, vector, num_frames=40, duration_s=10 * DT_S, start="rest")
    first = pulled(tree, row, vector, num_frames=20, duration_s=10 * DT_S, start="rest")
    group = ForceGroup(locality=Locality(seed_voxel=row, falloff_m=FALLOFF_M))
    rest = respond(
        tree.system, [group], dt_s=DT_S, num_frames=20, start=first.final, start_bends=first.final_bends, tree=tree
    )
    np.testing.assert_allclose(np.concatenate([first.bends[0], rest.bends[0]]), whole.bends[0], atol=1e-12)
    np.testing.assert_allclose(np.concatenate([first.q, rest.q]), whole.q, atol=1e-12)


def test_a_target_moves_its_answer_continuously(forked):
    """A pointer that moves by a hundredth moves every bend by little: the hand feels no snap."""
    tree, parts = forked
    row = parts["right"][-1]
    bends = [pulled(tree, row, (0.0, y, 0.1)).bends[0][0] for y in np.linspace(0.02, 0.6, 30)]
    assert max(np.abs(b - a).max() for a, b in pairwise(bends)) < 0.1
