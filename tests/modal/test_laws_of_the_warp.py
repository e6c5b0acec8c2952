"""What a large push must obey: bones turn, and keep their length."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamictree.devoxelize.shares import voxel_shares
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.modal.bone_attachment import attach_mesh
from dynamictree.modal.bones import bones_of
from dynamictree.modal.force import Drag, compliance, contact_at_voxel, equilibrium, generalised_force
from dynamictree.modal.frames import VertexFrames
from dynamictree.modal.system import displacement, modal_system
from dynamictree.modal.warp import bend, bone_turns, bone_weights, pose
from dynamictree.rig.rig import rig_of
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.voxelize import voxelize
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.modal.trees import VOXEL_M, fork

FINENESS = 3  # so that a branch has some bones


@pytest.fixture(scope="module")
def forked():
    spectrum, parts = fork(fineness=FINENESS)
    system = modal_system(spectrum)
    return system, bones_of(system), parts


@pytest.fixture
def q(forked, rng):
    return rng.normal(size=(1, forked[0].num_modes, 2)).view(np.complex128)[..., 0]


def posed(bones, q):
    everywhere = np.ones((1, len(bones.parent)), np.float32)
    return pose(bones, bone_turns(bones, everywhere, q))


def centres(bones, stance):
    return stance.place_m + np.einsum("bij,bj->bi", stance.rotation, bones.reach_m)


def test_parents_come_before_children_and_every_branch_has_its_own_bones(forked):
    _, bones, parts = forked
    assert (bones.parent < np.arange(len(bones.parent))).all()
    assert (bones.parent < 0).sum() == 1
    right, left = (set(bones.bone_of_voxel[parts[side][12:]].tolist()) for side in ("right", "left"))
    assert not right & left


def test_bones_keep_their_length_however_far_they_are_pushed(forked, q):
    _, bones, _ = forked
    stance = posed(bones, 50 * q)
    length = np.linalg.norm(centres(bones, stance) - stance.place_m, axis=1)
    np.testing.assert_allclose(length, np.linalg.norm(bones.reach_m, axis=1), atol=1e-5)
    above = bones.parent[1:]
    np.testing.assert_allclose(stance.place_m[1:], centres(bones, stance)[above], atol=1e-5)


def test_rotations_are_scipys(forked, q):
    _, bones, _ = forked
    for strength in (1e-4, 1.0, 30.0):
        turns = bone_turns(bones, np.ones((1, len(bones.parent)), np.float32), strength * q)
        expected = Rotation.from_rotvec(turns.astype(np.float64)).as_matrix()
        np.testing.assert_allclose(pose(bones, turns).rotation, expected, atol=2e-6)


def test_at_rest_nothing_moves(forked):
    system, bones, _ = forked
    stance = posed(bones, np.zeros((1, system.num_modes), complex))
    points = system.grid.centres_m
    moved = bend(bones, stance, points, bones.bone_of_voxel[:, None], np.ones((len(points), 1), np.float32))
    np.testing.assert_allclose(moved, 0, atol=1e-6)


def test_a_small_push_is_the_plain_answer(forked, q):
    """Bones are straight and their voxels few: to first order they follow the modes to a part in ten."""
    system, bones, parts = forked
    tiny = 1e-3 * q
    plain = displacement(system.shapes, tiny)[0]
    points = system.grid.centres_m
    bent = bend(bones, posed(bones, tiny), points, bones.bone_of_voxel[:, None], np.ones((len(points), 1), np.float32))
    for side in ("right", "left"):
        tip = parts[side][-1]
        np.testing.assert_allclose(bent[tip], plain[tip], atol=0.25 * np.linalg.norm(plain[tip]))


def test_a_bone_that_no_group_reaches_does_not_turn(forked, q):
    system, bones, _ = forked
    weights = np.ones((1, len(system.grid)), np.float32)
    weights[0, system.grid.coords[:, 0] < 25 * FINENESS] = 0
    per_bone = bone_weights(bones, weights)
    turns = bone_turns(bones, per_bone, q)
    still = (per_bone[0] == 0) & (per_bone[0][bones.parent] == 0)
    assert still.any()
    np.testing.assert_allclose(turns[still], 0, atol=1e-6)


def test_groups_add_up(forked, rng):
    system, bones, _ = forked
    q = rng.normal(size=(2, system.num_modes, 2)).view(np.complex128)[..., 0]
    weights = rng.random((2, len(bones.parent))).astype(np.float32)
    both = bone_turns(bones, weights, q)
    apart = sum(bone_turns(bones, weights[g : g + 1], q[g : g + 1]) for g in (0, 1))
    np.testing.assert_allclose(both, apart, atol=1e-4)


def test_a_strong_drag_bends_a_grown_tree_and_does_not_stretch_it():
    """Edge stretch at a top displacement of 20 % of the height: ten times less than that of plain modes."""
    sample = make_sample(9, "columnar")
    voxels, spectrum = voxel_spectrum(sample, 64)
    mesh, system = sample.mesh, modal_system(spectrum)
    top = int(np.argmax(voxels.grid.centres_m[:, 2]))
    at = contact_at_voxel(voxels.grid, top)
    softest = np.linalg.eigh(compliance(system, at))[1][:, 2]
    constant = generalised_force(system, Drag(at=at, force_n=tuple(softest.tolist())), dt_s=0.1, num_frames=1)
    q = equilibrium(system, constant).q
    q = q * 0.2 * mesh.height_m / np.linalg.norm(displacement(system.shapes, q)[0, top])

    bones, shares = bones_of(system), voxel_shares(voxels.grid, mesh)
    carried = attach_mesh(bones, mesh, shares, voxel_size_m=voxels.grid.voxel_size_m)
    bent = bend(bones, posed(bones, q), mesh.vertices, carried.rows, carried.weights)
    plain = VertexFrames(rig_of(mesh, spectrum), mesh.vertices, shares).displacement(q)

    def stretch(moved):
        start, end = edges_of(mesh.faces).T
        rest = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
        now = np.linalg.norm((mesh.vertices + moved)[start] - (mesh.vertices + moved)[end], axis=1)
        return float(np.percentile(np.abs(now / rest - 1)[rest > 1e-4], 99))

    assert stretch(bent) < 0.1 * stretch(plain)
    highest = int(np.argmax(mesh.vertices[:, 2]))
    assert np.linalg.norm(bent[highest]) > 0.15 * mesh.height_m


def test_a_coarse_pole_bends_as_its_voxels_do_and_its_foot_stands():
    rings = np.linspace(0, 12, 16)  # heights [m]; eight voxels from one to the next
    vertices = np.array([(x, y, z) for z in rings for x, y in ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))])
    around = np.array([(0, 1, 4), (1, 5, 4), (1, 2, 5), (2, 6, 5), (2, 3, 6), (3, 7, 6), (3, 0, 7), (0, 4, 7)])
    faces = np.concatenate([around + 4 * ring for ring in range(len(rings) - 1)])
    mesh = TriangleMesh(vertices=vertices.astype(np.float32), faces=faces.astype(np.int32))
    grid = voxelize(mesh, 128).grid
    coefficients = np.zeros((len(grid), 2, 3), np.complex64)
    coefficients[:, 1, 1] = (grid.centres_m[:, 2] / mesh.height_m) ** 2
    bones = bones_of(modal_system(SparseVoxelSpectrum(grid=grid, coefficients=coefficients)))
    ties = voxel_shares(grid, mesh)
    carried = attach_mesh(bones, mesh, ties, voxel_size_m=grid.voxel_size_m)
    stance = posed(bones, np.array([[1.5]], np.complex128))
    bent = bend(bones, stance, mesh.vertices, carried.rows, carried.weights)
    of_voxels = bend(bones, stance, mesh.vertices, bones.bone_of_voxel[ties.rows], ties.weights)
    top = np.linalg.norm(of_voxels[-4:], axis=1).mean()
    assert top > 0.15 * mesh.height_m
    assert np.linalg.norm(bent[:4], axis=1).max() < 0.02 * top
    assert np.linalg.norm(bent - of_voxels, axis=1).max() < 0.04 * top


def test_voxel_size_of_the_fixture_is_what_bones_are_measured_in(forked):
    _, bones, _ = forked
    length = np.linalg.norm(bones.reach_m[1:], axis=1)
    assert length.max() < 14 * VOXEL_M / FINENESS
