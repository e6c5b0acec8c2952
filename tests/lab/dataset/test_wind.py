from dataclasses import replace

import numpy as np
import pytest

from dynamictree.spectrum import NUM_FREQUENCIES, Wind, from_motion
from lab.dataset.branching import grow_trunks
from lab.dataset.filter import edge_stretch
from lab.dataset.motion import vertex_spectrum
from lab.dataset.rotation import product, quaternion_of, rotate, to_matrix
from lab.dataset.sample import SPECIES, make_sample
from lab.dataset.sapling import LEAF, grow_tree
from lab.dataset.species import Foliage
from lab.dataset.wind import _bending_radius, sway, sway_stems
from tests.lab.dataset.stems import tables_of


def test_a_quaternion_chain_is_a_matrix_chain(rng):
    vectors = rng.normal(0, 0.4, (2, 3, 7)).astype(np.float32)
    first, second = (quaternion_of(vector) for vector in vectors)
    np.testing.assert_allclose(np.linalg.norm(first, axis=0), 1, atol=1e-6)
    eye = np.eye(3)[:, :, None]
    chained = np.einsum("xyn,yzn->xzn", to_matrix(first) + eye, to_matrix(second) + eye)
    np.testing.assert_allclose(to_matrix(product(first, second)) + eye, chained, atol=1e-5)
    point = rng.normal(0, 1, (3, 7)).astype(np.float32)
    np.testing.assert_allclose(rotate(first, point), np.einsum("xyn,yn->xn", to_matrix(first) + eye, point), atol=1e-5)
    small = np.float32(1e-3) * vectors[0]
    np.testing.assert_allclose(rotate(quaternion_of(small), point) - point, np.cross(small, point, axis=0), atol=1e-5)


def test_a_bare_tree_sways_faster_than_in_leaf_and_its_stems_ring():
    """The same stems, with and without leaves."""
    tree = grow_tree(SPECIES["birch"], np.random.default_rng(0))
    without = replace(tree, leaves=(), species=replace(tree.species, foliage=Foliage(kind="none")))
    leaf, bare = (sway(one, Wind(), np.random.default_rng(1)).shift for one in (tree, without))
    leaf = leaf[:, : bare.shape[1]]  # stems come first
    power = [(np.abs(np.fft.rfft(shift, axis=0)) ** 2).sum(axis=(1, 2))[1:NUM_FREQUENCIES] for shift in (leaf, bare)]
    bins = np.arange(1, NUM_FREQUENCIES)
    assert (power[1] @ bins) / power[1].sum() > (power[0] @ bins) / power[0].sum()
    assert power[1][3:10].sum() > 2 * power[0][3:10].sum()


def test_roots_do_not_move_at_all(spreading):
    displacement = spreading.displacement()
    roots = spreading.mesh.vertices[:, 2] == 0
    assert roots.any()
    assert (displacement[:, roots] == 0).all()
    assert (spreading.coefficients[roots] == 0).all()


def trunk_motion(*, flare):
    """Spectrum of the rings of a trunk of 10 m that bears nothing, [P, K, 3], and its radii above the ground."""
    trunk = grow_trunks(replace(SPECIES["palm"], flare=flare, height_m=(10.0, 10.0)), np.random.default_rng(0))
    motion = sway_stems((trunk,), Wind(), np.random.default_rng(1), bare=True)
    return vertex_spectrum(motion, motion.position, np.arange(len(motion.position), dtype=np.int32)), trunk.radii[0, 1:]


def test_a_flare_at_the_ground_does_not_change_how_a_trunk_sways():
    (without, above), (flared, above_flare) = (trunk_motion(flare=flare) for flare in (0.0, 0.8))
    np.testing.assert_allclose(above, above_flare, rtol=0.05)
    np.testing.assert_allclose(np.abs(flared), np.abs(without), atol=0.03 * np.abs(without).max())


def test_a_trunk_with_the_usual_flare_leans_as_by_its_radius_at_the_ground():
    tree = grow_tree(SPECIES["round-broadleaf"], np.random.default_rng(0))
    trunk = tree.stems[0]
    assert _bending_radius(trunk, is_trunk=True)[0] == pytest.approx(trunk.radii[0, 0], rel=0.1)
    branches = tree.stems[1]
    rows = np.arange(len(branches.points))
    np.testing.assert_array_equal(_bending_radius(branches, is_trunk=False), branches.radii[rows, branches.first])


def test_nothing_is_torn_or_stretched(spreading, sapling):
    for sample in (spreading, sapling):
        displacement = sample.motion.frames(np.arange(0, 100, 9)).displacement(sample.mesh.vertices, sample.node)
        assert edge_stretch(sample.mesh.vertices, sample.mesh.faces, displacement, percentile=100.0) < 0.03


def test_a_child_stays_on_its_parent(spreading):
    """In every frame a stem's first ring keeps its distance to both parent rings beside it."""
    skeleton = spreading.skeleton
    first = np.flatnonzero((skeleton.parent >= 0) & (skeleton.stem != skeleton.stem[skeleton.parent]))
    moved = skeleton.position + spreading.motion.shift[:, : len(skeleton.position)]
    for node, rest in ((skeleton.parent[first], skeleton.position), (skeleton.parent[first] + 1, skeleton.position)):
        before = np.linalg.norm(rest[first] - rest[node], axis=1)
        after = np.linalg.norm(moved[:, first] - moved[:, node], axis=2)
        np.testing.assert_allclose(after, np.broadcast_to(before, after.shape), atol=2e-4)


def test_the_vertex_spectrum_is_that_of_the_motion(sapling):
    np.testing.assert_allclose(sapling.coefficients, from_motion(sapling.displacement()), atol=1e-6)


def test_a_loop_stays_on_its_bins():
    tree = grow_tree(SPECIES["birch"], np.random.default_rng(0))
    motion = sway(tree, Wind(speed_m_s=8.0), np.random.default_rng(1))
    power = (np.abs(np.fft.rfft(motion.shift, axis=0)) ** 2).sum(axis=(1, 2))
    assert power[NUM_FREQUENCIES:].sum() < 1e-4 * power[1:].sum()  # what the turns' second order couples


def test_sway_and_lean_grow_with_wind_speed():
    tree = grow_tree(SPECIES["round-broadleaf"], np.random.default_rng(0))
    swaying, leaning = [], []
    for speed in (1.0, 3.0, 6.0, 10.0):
        motion = sway(tree, Wind(speed_m_s=speed), np.random.default_rng(1))
        swaying.append(motion.shift.std(axis=0).mean())
        leaning.append(motion.shift.mean(axis=0)[:, 0].mean())
    assert (np.diff(swaying) > 0).all()
    assert (np.diff(leaning) > 0).all()


def test_no_wind_no_motion():
    tree = grow_tree(SPECIES["sapling"], np.random.default_rng(0))
    np.testing.assert_allclose(sway(tree, Wind(speed_m_s=0.0), np.random.default_rng(1)).shift, 0, atol=1e-6)


def test_gusts_drive_the_sway_and_not_the_lean():
    tree = grow_tree(SPECIES["sapling"], np.random.default_rng(0))
    still, gusty = (sway(tree, Wind(gust=gust), np.random.default_rng(1)).shift for gust in (0.0, 0.4))
    assert still.std(axis=0).max() < 1e-5
    assert gusty.std(axis=0).max() > 1e-2
    np.testing.assert_allclose(gusty.mean(axis=0), still.mean(axis=0), atol=0.1 * np.abs(still).max())


@pytest.mark.parametrize("direction_deg", [0.0, 90.0, 215.0])
def test_the_tree_leans_downwind(direction_deg):
    tree = grow_tree(SPECIES["columnar"], np.random.default_rng(0))
    mean = sway(tree, Wind(direction_deg=direction_deg), np.random.default_rng(1)).shift.mean(axis=(0, 1))
    heading = np.deg2rad(direction_deg)
    downwind = mean[0] * np.cos(heading) + mean[1] * np.sin(heading)
    assert downwind > 0.9 * np.linalg.norm(mean[:2]) > 0


def test_tips_go_a_few_percent_of_the_height_in_a_fresh_breeze():
    for name in ("round-broadleaf", "conical-conifer", "palm", "sapling"):
        sample = make_sample(3, name, wind=Wind(speed_m_s=5.0))
        assert 0.01 < np.linalg.norm(sample.displacement(), axis=2).max() / sample.mesh.height_m < 0.15


def test_trunks_are_slow_twigs_faster_and_leaves_fastest():
    sample = make_sample(2, "round-broadleaf")
    table = tables_of(sample)
    medians = [np.median(table.frequency_hz[table.level == depth]) for depth in range(3)]
    assert medians[0] < medians[1] < medians[2]
    energy = (np.abs(sample.coefficients[:, 1:]) ** 2).sum(axis=2)
    pitch = (energy * np.arange(1, NUM_FREQUENCIES)).sum(axis=1) / np.maximum(energy.sum(axis=1), 1e-30)
    trunk = pitch[(sample.part == 0) & (energy.sum(axis=1) > 0)].mean()
    assert trunk < pitch[sample.part == LEAF].mean()


def test_leaves_are_rigid(sapling):
    tree_faces = sapling.mesh.faces[(sapling.part[sapling.mesh.faces] == LEAF).all(axis=1)]
    displacement = sapling.motion.frames(np.arange(0, 100, 10)).displacement(sapling.mesh.vertices, sapling.node)
    assert edge_stretch(sapling.mesh.vertices, tree_faces, displacement, percentile=100.0) < 1e-3
