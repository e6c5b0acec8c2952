"""Bones that only turn: no wind changes a length, points are where the equations say, and no fit runs away."""

import gc
import io
import weakref
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse.linalg
import trimesh
from scipy.spatial.transform import Rotation

from dynamictree import method
from dynamictree.errors import FormatError
from dynamictree.formats.tensors.container import read_tensors, write_tensors
from dynamictree.formats.tensors.rig import read_rig, write_rig
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.requests import Wind
from dynamictree.rig.pose import GROUND, Weights
from dynamictree.rig.rig import Rig, rig_of
from dynamictree.rig.surface_skeleton import surface_bones
from dynamictree.rig.turn_fit import _Problem, _State
from dynamictree.spectrum import SparseVoxelSpectrum, iter_motion
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.formats.meshes import written
from tests.models.small.test_dense_foliage import bush
from tests.plant.stand import grown

Tree = tuple[TriangleMesh, SparseVoxelSpectrum, Rig]


@pytest.fixture(scope="module")
def tree() -> Tree:
    sample = make_sample(3, "sapling")
    spectrum = voxel_spectrum(sample, 64)[1]
    return sample.mesh, spectrum, rig_of(sample.mesh, spectrum)


def test_a_point_is_where_the_equations_say(tree: Tree, rng) -> None:
    mesh, _, rig = tree
    theta = rng.normal(0, 0.4, (len(rig.skeleton), 3)).astype(np.float32)
    theta[GROUND] = 0
    moved = mesh.vertices + rig.displacement(theta, mesh.vertices, rig.vertices)
    size = np.maximum(np.linalg.norm(theta, axis=1, keepdims=True), 1e-12)
    turns = Rotation.from_rotvec(theta / size * np.arctan(size)).as_matrix()
    foot, parent = rig.skeleton.foot_m.astype(np.float64), rig.skeleton.parent
    place = [foot[0]]
    for bone in range(1, len(foot)):
        place.append(place[parent[bone]] + turns[parent[bone]] @ (foot[bone] - foot[parent[bone]]))
    for vertex in rng.integers(0, mesh.num_vertices, 50):
        point, bones = mesh.vertices[vertex], zip(rig.vertices.rows[vertex], rig.vertices.shares[vertex], strict=True)
        there = sum(w * (place[b] + turns[b] @ (point - foot[b])) for b, w in bones)
        np.testing.assert_allclose(moved[vertex], there, atol=1e-5)


def test_no_turn_changes_the_size_of_a_card_or_parts_a_bone_from_its_parent(tree: Tree, rng) -> None:
    mesh, spectrum, rig = tree
    theta = rng.normal(0, 2, (len(rig.skeleton), 3)).astype(np.float32)
    moved = mesh.vertices + rig.displacement(theta, mesh.vertices, rig.vertices)
    in_card = surface_bones(mesh, spectrum.grid).in_card
    cards = mesh.faces[in_card[mesh.faces].all(axis=1)]
    assert len(cards) > 100
    rest, now = (np.linalg.norm(np.diff(places[cards], axis=1), axis=2) for places in (mesh.vertices, moved))
    np.testing.assert_allclose(now, rest, atol=1e-5)
    bones = np.arange(1, len(rig.skeleton), dtype=np.int32)
    one = np.ones((len(bones), 1), np.float32)
    by_own, by_parent = (
        rig.displacement(theta, rig.skeleton.foot_m[1:], Weights(rows=rows[:, None], shares=one))
        for rows in (bones, rig.skeleton.parent[1:])
    )
    np.testing.assert_allclose(by_own, by_parent, atol=1e-5)


@pytest.mark.parametrize(("species", "seed"), [("conical-conifer", 6), ("shrub", 5)])
def test_it_is_near_the_simulators_truth_in_a_breeze_and_in_a_storm(species: str, seed: int) -> None:
    """Every fourth frame: 0.12 and 0.13, 0.12 and 0.09 were missing where displacements were fitted."""
    for speed_m_s, most in ((5.0, 0.13), (20.0, 0.13)):
        sample = make_sample(seed, species, wind=Wind(speed_m_s=speed_m_s, gust=0.4))
        truth, (_, spectrum) = sample.displacement(), voxel_spectrum(sample)
        frames, vertices = np.arange(0, len(truth), 4), sample.mesh.vertices
        rig = rig_of(sample.mesh, spectrum)
        motion = [rig.displacement(theta, vertices, rig.vertices) for theta in rig.theta(frames / spectrum.num_frames)]
        sway = np.sqrt(((truth - truth.mean(axis=0)) ** 2).sum(axis=2).mean())
        assert np.sqrt(((np.stack(motion) - truth[frames]) ** 2).sum(axis=2).mean()) < most * sway
        assert np.percentile(list(_growths(sample.mesh, motion)), 99) < 0.01


@pytest.mark.parametrize("times", [3.0, 10.0])
def test_no_motion_runs_away(tree: Tree, times: float) -> None:
    """Larger than any wind makes it: what cannot be reached is left, and the rest does not get worse."""
    mesh, spectrum, _ = tree
    strong = replace(spectrum, coefficients=(times * spectrum.coefficients).astype(np.complex64))
    rig = rig_of(mesh, strong)
    phases = np.arange(20) / 20
    wanted = np.stack(list(iter_motion(strong.coefficients, phases, strong.num_frames)))
    moved = np.stack([rig.displacement(theta, spectrum.grid.centres_m, rig.voxels) for theta in rig.theta(phases)])
    sway = np.sqrt((wanted**2).sum(axis=2).mean())
    assert np.sqrt(((moved - wanted) ** 2).sum(axis=2).mean()) < (0.3 if times == 3.0 else 0.8) * sway
    assert np.linalg.norm(moved, axis=2).max() < 2 * mesh.height_m


def test_the_foot_of_a_trunk_moves_as_its_voxels_whatever_its_crown_misses() -> None:
    """In a generated motion. It moved 8 times as far when each voxel counted alike."""
    mesh = grown("sapling", seed=0)
    spectrum = method.generate(method.voxelize(mesh), wind=Wind(speed_m_s=8.0), seed=0)
    rig, places = rig_of(mesh, spectrum), spectrum.grid.centres_m
    foot = (places[:, 2] > 0.02 * mesh.height_m) & (places[:, 2] < 0.14 * mesh.height_m)
    sizes = [np.abs(motion[foot, 1:]).sum() for motion in (rig.loop(places, rig.voxels), spectrum.coefficients)]
    assert sizes[0] < 1.5 * sizes[1]


def test_a_storm_of_the_model_breaks_no_wood() -> None:
    """Limbs that followed noise of voxels made edges grow by 2.6 %: where a branch forks, both stems pull at edges."""
    mesh = grown("palm", seed=0)
    rig = rig_of(mesh, method.generate(method.voxelize(mesh), wind=Wind(speed_m_s=20.0), seed=0))
    motion = [rig.displacement(theta, mesh.vertices, rig.vertices) for theta in rig.theta(np.arange(8) / 8)]
    assert np.percentile(list(_growths(mesh, motion)), 99) < 0.01


def test_the_system_of_a_dense_bush_grows_with_its_cards(monkeypatch) -> None:
    """Cards that share voxels: the factors had 2,600 numbers a bone when voxels coupled them, and now 37.

    Each is gone before the next is made: those of bananas in photos have 440 MB. So is a step that was no better.
    """
    mesh, splu, simulate = bush(3000, card_m=0.15, radius_m=1.0), scipy.sparse.linalg.splu, _Problem.simulate
    in_memory: weakref.WeakSet[object] = weakref.WeakSet()
    sizes, loops = [], []

    class Factor:
        def __init__(self, *system: object, **options: object) -> None:
            assert not in_memory
            in_memory.add(self)
            factor = splu(*system, **options)
            self.solve = factor.solve
            sizes.append(factor.L.nnz)

    monkeypatch.setattr(scipy.sparse.linalg, "splu", Factor)
    num_loops = lambda: sum(type(one) is _State for one in gc.get_objects())  # noqa: E731
    monkeypatch.setattr(_Problem, "simulate", lambda *given: loops.append(num_loops()) or simulate(*given))
    grid = method.voxelize(mesh, resolution=64).grid
    modes = np.repeat(0.02 * grid.centres_m[:, None], 2, axis=1).astype(np.complex64)
    rig_of(mesh, SparseVoxelSpectrum(grid=grid, coefficients=modes))
    assert max(sizes) < 60 * 3200
    assert max(loops) == 1


def test_a_crown_that_is_one_surface_does_not_tear_when_the_wind_turns() -> None:
    """The field itself stretches by 15 %. Bones that followed it as far as they could did by 10 %, turned by 12."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = np.add(ball.vertices, [0, 0, 1]).astype(np.float32)
    mesh = TriangleMesh(vertices=vertices, faces=ball.faces.astype(np.int32))
    grid = method.voxelize(mesh, resolution=64).grid
    x, y, z = grid.centres_m.T
    modes = np.zeros((len(grid), 4, 3), np.complex64)
    modes[:, 0, 0], modes[:, 1, 0], modes[:, 1, 1] = 0.05 * z**2, 0.03 * z**2, 0.02j * z**2
    modes[:, 2, 2] = 0.01 * z * np.exp(3j * x) * np.cos(2 * y)
    modes[:, 3, 0] = 0.008 * z * np.exp(4j * y)
    rig = rig_of(mesh, SparseVoxelSpectrum(grid=grid, coefficients=modes))
    assert rig.skeleton.in_surface.mean() > 0.9
    turn = np.float32(trimesh.transformations.rotation_matrix(np.radians(30), [0, 0, 1])[:3, :3])
    loop = list(rig.theta(np.arange(8) / 8))
    winds = ([rig.in_wind(theta, wind) for theta in loop] for wind in (np.eye(3, dtype=np.float32), turn))
    motions = ([rig.displacement(theta, vertices, rig.vertices) for theta in thetas] for thetas in winds)
    own, turned = (np.percentile(list(_growths(mesh, motion)), 99) for motion in motions)
    assert 0.001 < own <= max(own, turned) < 0.035


def test_a_file_gives_the_rig_back_bit_by_bit(tree: Tree) -> None:
    read = read_rig(io.BytesIO(written(write_rig, tree[2])))
    np.testing.assert_array_equal(read.turns, tree[2].turns)
    for part in ("vertices", "voxels"):
        for name in ("rows", "shares"):
            np.testing.assert_array_equal(getattr(getattr(read, part), name), getattr(getattr(tree[2], part), name))
    assert written(write_rig, read) == written(write_rig, tree[2])


def test_a_file_whose_bones_do_not_fit_together_is_refused(tree: Tree) -> None:
    tensors, metadata = read_tensors(io.BytesIO(written(write_rig, tree[2])), file_format="tree-rig", version="1")
    cases = ("parent", 5, 9, "not in order"), ("parent", 0, 0, "not in order"), ("vertex_bone", 3, 10**6, "names bone")
    for name, row, value, words in cases:
        broken = {key: tensor.copy() for key, tensor in tensors.items()}
        broken[name][row] = value
        hostile = io.BytesIO()
        write_tensors(hostile, broken, metadata)
        with pytest.raises(FormatError, match=words):
            read_rig(io.BytesIO(hostile.getvalue()))


def _growths(mesh: TriangleMesh, motion: list[np.ndarray]) -> list[np.ndarray]:
    """Of each frame how much each edge grows, as a share of its length."""
    one, other = edges_of(mesh.faces).T
    places = (mesh.vertices, *(mesh.vertices + moved for moved in motion))
    rest, *lengths = (np.linalg.norm(now[one] - now[other], axis=1) for now in places)
    return [np.abs(now[rest > 1e-6] / rest[rest > 1e-6] - 1) for now in lengths]
