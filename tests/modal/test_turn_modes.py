"""Bones that only turn: no wind changes a length, a breeze is a sum of modes, and the motion's own loop comes back."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dynamictree import method
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.modal.turbulence import turned_about_z
from dynamictree.modal.turn_modes import half_turns, posed, turn_modes, turned
from dynamictree.modal.turn_skeleton import GROUND, TurnSkeleton, turn_skeleton
from dynamictree.spectrum import SparseVoxelSpectrum, iter_motion
from lab.dataset.sample import make_sample, voxel_spectrum

Tree = tuple[TriangleMesh, SparseVoxelSpectrum, TurnSkeleton, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def tree() -> Tree:
    sample = make_sample(3, "sapling")
    spectrum = voxel_spectrum(sample, 32)[1]
    skeleton = turn_skeleton(sample.mesh, spectrum.grid)
    coefficients = method.devoxelize(spectrum, sample.mesh)
    turns = turn_modes(skeleton, sample.mesh, coefficients, spectrum.num_frames)
    return sample.mesh, spectrum, skeleton, coefficients, turns


def test_parents_come_before_children_and_only_the_ground_has_none(tree: Tree) -> None:
    parent = tree[2].parent
    assert parent[GROUND] == -1
    assert (parent[1:] >= 0).all()
    assert (parent[1:] < np.arange(1, len(parent))).all()
    assert tree[2].depths.max() > 5


def test_no_turns_change_the_size_of_a_card_or_the_length_of_a_bone(tree: Tree, rng: np.random.Generator) -> None:
    mesh, _, skeleton, _, _ = tree
    theta = rng.normal(0, 2, (len(skeleton.parent), 3)).astype(np.float32)
    theta[GROUND] = 0
    moved = mesh.vertices + posed(skeleton, mesh.vertices, theta)
    cards = mesh.faces[skeleton.in_card[mesh.faces].all(axis=1)]
    assert len(cards) > 100
    for a, b in ((0, 1), (1, 2)):
        rest = np.linalg.norm(mesh.vertices[cards[:, a]] - mesh.vertices[cards[:, b]], axis=1)
        now = np.linalg.norm(moved[cards[:, a]] - moved[cards[:, b]], axis=1)
        np.testing.assert_allclose(now, rest, atol=1e-6)
    # a vertex at each foot, carried by the bone and then by its parent
    bones = np.arange(1, len(skeleton.parent), dtype=np.int32)
    none = np.zeros(len(bones), np.float32)
    own = replace(skeleton, bone=bones, parent_share=none, in_card=none > 0)
    other = replace(own, bone=skeleton.parent[1:])
    foot = skeleton.foot_m[1:]
    np.testing.assert_allclose(posed(own, foot, theta), posed(other, foot, theta), atol=1e-6)


def test_a_turn_is_by_the_arc_tangent(rng: np.random.Generator) -> None:
    theta = np.array([[0, 0, 1.0], [0, 0, 1e9], [0, 0, 0]])
    there = turned(half_turns(theta), np.tile([1.0, 0, 0], (3, 1)))
    np.testing.assert_allclose(there, [[np.sqrt(0.5), np.sqrt(0.5), 0], [0, 1, 0], [1, 0, 0]], atol=1e-6)
    arm = rng.normal(size=(50, 3))
    longer = np.linalg.norm(turned(half_turns(rng.normal(size=(50, 3))), arm), axis=1) / np.linalg.norm(arm, axis=1)
    np.testing.assert_allclose(longer, 1)


def test_a_breeze_is_a_sum_of_modes(tree: Tree) -> None:
    mesh, spectrum, skeleton, coefficients, _ = tree
    breeze = (0.01 * coefficients).astype(np.complex64)
    turns = turn_modes(skeleton, mesh, breeze, spectrum.num_frames)
    assert _error(mesh, skeleton, turns, breeze, spectrum.num_frames) < 0.04
    # and linear: twice the turns move vertices twice as far
    theta = next(iter_motion(turns, np.array([0.3]), spectrum.num_frames))
    once, twice = (posed(skeleton, mesh.vertices, times * theta) for times in (np.float32(1), np.float32(2)))
    assert np.abs(twice - 2 * once).max() < 2e-3 * np.abs(twice).max()


def test_the_loop_of_the_motion_comes_back(tree: Tree) -> None:
    mesh, spectrum, skeleton, coefficients, turns = tree
    assert _error(mesh, skeleton, turns, coefficients, spectrum.num_frames) < 0.04


def test_no_fit_runs_away(tree: Tree) -> None:
    """However large the motion is, the loop is nearer to it than bones that stand still."""
    mesh, spectrum, skeleton, coefficients, _ = tree
    huge = (20 * coefficients).astype(np.complex64)
    turns = turn_modes(skeleton, mesh, huge, spectrum.num_frames)
    assert _error(mesh, skeleton, turns, huge, spectrum.num_frames) < 0.9


def test_edges_keep_their_lengths_in_a_storm(tree: Tree) -> None:
    mesh, spectrum, skeleton, _, turns = tree
    edges = edges_of(mesh.faces)
    rest = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    growth = []
    for theta in iter_motion(turns, np.arange(8) / 8, spectrum.num_frames):
        moved = mesh.vertices + posed(skeleton, mesh.vertices, np.float32(4) * theta)
        growth.append(np.abs(np.linalg.norm(moved[edges[:, 0]] - moved[edges[:, 1]], axis=1) / rest - 1))
    assert np.percentile(growth, 99) < 0.003


def test_a_crown_that_is_one_surface_keeps_its_edges_when_the_wind_turns() -> None:
    mesh, coefficients = _shaking_crown()
    skeleton = turn_skeleton(mesh, method.voxelize(mesh).grid)
    assert skeleton.in_surface.mean() > 0.9
    turns = turn_modes(skeleton, mesh, coefficients, num_frames=100)
    edges, swing = edges_of(mesh.faces), skeleton.directions
    rest = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    largest = []
    for wind_turn in (0.0, np.radians(30)):
        growth = []
        for theta in iter_motion(turns, np.arange(8) / 8, 100):
            along = (theta * swing).sum(axis=1, keepdims=True) * swing
            blown = np.cross(swing, np.cross(theta, swing) @ turned_about_z(wind_turn).T) + along
            moved = mesh.vertices + posed(skeleton, mesh.vertices, blown.astype(np.float32))
            growth.append(np.abs(np.linalg.norm(moved[edges[:, 0]] - moved[edges[:, 1]], axis=1) / rest - 1))
        largest.append(np.percentile(growth, 99))
    assert largest[0] > 0.001
    assert largest[1] < 1.2 * largest[0]


def test_what_is_no_plant_stands_still(tree: Tree) -> None:
    mesh, spectrum, _, coefficients, _ = tree
    pot = mesh.vertices[:, 2] < 0.1 * mesh.vertices[:, 2].max()
    still_faces = pot[mesh.faces].all(axis=1)
    assert still_faces.any()
    potted = replace(mesh, still_faces=still_faces)
    skeleton = turn_skeleton(potted, spectrum.grid)
    assert (skeleton.bone[potted.still_vertices] == GROUND).all()
    turns = turn_modes(skeleton, mesh, coefficients, spectrum.num_frames)
    assert np.abs(turns[GROUND]).max() < 1e-4


def test_a_floor_that_stands_still_changes_no_bone(tree: Tree) -> None:
    mesh, spectrum, skeleton, _, _ = tree
    floor = np.array([[-50, -50, 0], [50, -50, 0], [0, 50, 0]], np.float32)
    faces = np.concatenate([mesh.faces, [[mesh.num_vertices, mesh.num_vertices + 1, mesh.num_vertices + 2]]])
    wide = TriangleMesh(
        vertices=np.concatenate([mesh.vertices, floor]),
        faces=faces.astype(np.int32),
        still_faces=np.arange(len(faces)) == len(mesh.faces),
    )
    there = turn_skeleton(wide, spectrum.grid)
    np.testing.assert_array_equal(there.parent, skeleton.parent)
    np.testing.assert_array_equal(there.bone[: mesh.num_vertices], skeleton.bone)
    assert (there.bone[mesh.num_vertices :] == GROUND).all()


def _shaking_crown() -> tuple[TriangleMesh, np.ndarray]:
    """A ball of 2 m on the ground, which sways and whose boughs shake apart; its modes [N, 4, 3]."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = np.add(ball.vertices, [0, 0, 1]).astype(np.float32)
    x, y, z = vertices.T
    modes = np.zeros((len(vertices), 4, 3), np.complex64)
    modes[:, 0, 0], modes[:, 1, 0], modes[:, 1, 1] = 0.05 * z**2, 0.03 * z**2, 0.02j * z**2
    modes[:, 2, 2] = 0.01 * z * np.exp(3j * x) * np.cos(2 * y)
    modes[:, 3, 0] = 0.008 * z * np.exp(4j * y)
    return TriangleMesh(vertices=vertices, faces=ball.faces.astype(np.int32)), modes


def _error(
    mesh: TriangleMesh, skeleton: TurnSkeleton, turns: np.ndarray, coefficients: np.ndarray, num_frames: int
) -> float:
    """Of the motion in a loop."""
    phases = np.arange(8) / 8
    theta, moved = (iter_motion(modes, phases, num_frames) for modes in (turns, coefficients))
    pairs = [(posed(skeleton, mesh.vertices, turn) - u, u) for turn, u in zip(theta, moved, strict=True)]
    return float(np.sqrt(sum((gap**2).sum() for gap, _ in pairs) / sum((u**2).sum() for _, u in pairs)))
