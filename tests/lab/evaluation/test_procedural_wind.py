"""The procedural rival is Weber and Penn's wind as the add-on bakes it, on any skeleton."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynamictree.mesh import edges_of
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from lab.evaluation.procedural_wind import (
    GUST_HZ,
    BoneMotion,
    Bones,
    bend,
    bones_of,
    rest_axes,
    sway_as_sapling,
)
from lab.evaluation.sapling_file import SaplingTree, read_sapling, sapling_files

FRAMES = np.arange(1, 101)


@pytest.fixture(scope="module", params=["quaking_aspen_s0", "small_pine_s0"])
def file(request: pytest.FixtureRequest, samples: Path) -> Path:
    return samples / "sapling" / f"{request.param}.npz"


@pytest.fixture(scope="module")
def baked(file: Path) -> SaplingTree:
    return read_sapling(file)


@pytest.fixture(scope="module")
def matrices(file: Path) -> np.ndarray:
    with np.load(file, allow_pickle=False) as arrays:
        return arrays["bone_mats"].astype(np.float64)


def test_the_tree_that_is_read_moves_as_it_was_baked(baked: SaplingTree, matrices: np.ndarray) -> None:
    motion = BoneMotion(turn=matrices[:, :, :3, :3].astype(np.float32), shift=matrices[:, :, :3, 3].astype(np.float32))
    error = motion.displacement(baked.mesh.vertices, baked.bone) - baked.displacement
    assert np.linalg.norm(error) < 0.02 * np.linalg.norm(baked.displacement)


def test_the_formula_is_the_add_ons(baked: SaplingTree, matrices: np.ndarray) -> None:
    """Fitting only phases, the angles of the add-on's own bones have our amplitudes, frequencies and gust."""
    bones, axes = baked.bones, rest_axes(baked.bones)
    length, size = bend(bones)
    along = (bones.tail - bones.head) / np.linalg.norm(bones.tail - bones.head, axis=1, keepdims=True)
    checked = 0
    for bone in np.flatnonzero((size > 0) & (bones.parent >= 0)):
        above, own = matrices[:, bones.parent[bone], :3, :3], matrices[:, bone, :3, :3]
        local = axes[bone].T @ above.transpose(0, 2, 1) @ own @ axes[bone]
        around_x, around_z = np.arctan2(local[:, 2, 1], local[:, 2, 2]), np.arctan2(local[:, 1, 0], local[:, 0, 0])
        fast = 1 / (4 * np.sqrt(length[bone]))
        waves = [f(rate * FRAMES) for rate in (fast, 0.7 * fast) for f in (np.sin, np.cos)]
        gust = np.sin(2 * np.pi * GUST_HZ / 24 * FRAMES) + 0.6
        for angle, sign in ((around_x, along[bone, 2]), (around_z, -along[bone, 0])):
            fitted, *_ = np.linalg.lstsq(np.stack([*waves, gust], axis=1), angle, rcond=None)
            assert np.hypot(*fitted[:2]) == pytest.approx(size[bone] / 50, rel=1e-3)
            assert np.hypot(*fitted[2:4]) == pytest.approx(0.65 * size[bone] / 50, rel=1e-3)
            assert fitted[4] == pytest.approx(sign * size[bone] / 50, abs=1e-3 * size[bone] / 50)
            checked += 1
    assert checked > 100


def test_our_own_bake_sways_as_far_as_the_add_ons(baked: SaplingTree) -> None:
    swayed = sway_as_sapling(baked.bones, np.random.default_rng(0), loop=False)
    ours, theirs = swayed.displacement(baked.mesh.vertices, baked.bone), baked.displacement
    spread = [np.linalg.norm(one - one.mean(axis=0), axis=2).mean() for one in (ours, theirs)]
    assert spread[0] / spread[1] == pytest.approx(1, abs=0.5)  # two phases a stem decide where in a slow sway we look
    lean = [one.mean(axis=(0, 1)) for one in (ours, theirs)]
    assert lean[0][1] == pytest.approx(lean[1][1], rel=0.3)
    assert abs(lean[0][0]) < 0.1 * abs(lean[0][1])


@pytest.mark.parametrize("species", ["weeping", "palm", "pine", "shrub"])
def test_a_dataset_tree_moves_without_stretching_and_loops(species: str) -> None:
    tree = grow_tree(SPECIES[species], np.random.default_rng(4))
    bones, bone = bones_of(tree)
    assert (bones.parent < np.arange(len(bones.parent))).all()
    swayed = sway_as_sapling(bones, np.random.default_rng(0), num_frames=50)
    displacement = swayed.displacement(tree.mesh.vertices, bone)
    height = tree.mesh.height_m
    ground = tree.mesh.vertices[:, 2] < 1e-4 * height
    assert np.abs(displacement[:, ground]).max() < 1e-5 * height
    assert 0.002 < np.linalg.norm(displacement, axis=2).max() / height < 0.3
    edges = edges_of(tree.mesh.faces)
    rest = np.linalg.norm(tree.mesh.vertices[edges[:, 0]] - tree.mesh.vertices[edges[:, 1]], axis=1)
    moved = tree.mesh.vertices + displacement[::10]
    length = np.linalg.norm(moved[:, edges[:, 0]] - moved[:, edges[:, 1]], axis=2)
    assert np.percentile(np.abs(length / rest - 1), 99) < 0.02
    steps = np.linalg.norm(np.diff(displacement, axis=0), axis=2).max()
    assert np.linalg.norm(displacement[0] - displacement[-1], axis=1).max() < 1.05 * steps


def test_no_wind_moves_nothing_and_twigs_turn_farther_than_the_trunk() -> None:
    tree = grow_tree(SPECIES["round-broadleaf"], np.random.default_rng(4))
    bones, bone = bones_of(tree)
    still = sway_as_sapling(bones, np.random.default_rng(0), wind=0.0, num_frames=10)
    assert np.abs(still.displacement(tree.mesh.vertices, bone)).max() < 1e-4
    _, size = bend(bones)
    trunk = np.isin(bones.stem, bones.trunk)
    assert np.median(size[~trunk & (size > 0)]) > np.median(size[trunk & (size > 0)])
    assert (size[bones.step < 0] == 0).all()


def test_a_stem_is_as_long_as_its_number_of_bones_times_the_first() -> None:
    """The add-on's length, in the stem's frequency and in how far its bones bend."""
    top = np.array([1, 3, 5], np.float32)  # a bone of 1 m, then two of 2 m
    on_z = np.array([0, 0, 1], np.float32)
    bones = Bones(
        head=np.r_[0, top[:-1]].astype(np.float32)[:, None] * on_z,
        tail=top[:, None] * on_z,
        parent=np.array([-1, 0, 1], np.int32),
        stem=np.zeros(3, np.int32),
        step=np.arange(3, dtype=np.int32),
        radius=np.full(3, 0.1, np.float32),
        trunk=np.zeros(1, np.int32),
    )
    length, size = bend(bones)
    np.testing.assert_allclose(length, 3)
    np.testing.assert_allclose(size, [0, 0, np.deg2rad(2 * 1 * (1 - 2 / 4) / 0.1)], rtol=1e-6)


def test_a_stem_that_forks_off_bends_by_its_own_bones_not_by_the_joint() -> None:
    bones, _ = bones_of(grow_tree(SPECIES["weeping"], np.random.default_rng(4)))  # has seven forks
    length, size = bend(bones)
    of_bone = np.linalg.norm(bones.tail - bones.head, axis=1)
    assert (of_bone[size > 0] > 0).all()
    total = np.bincount(bones.stem, of_bone * (bones.step >= 0))[bones.stem]
    np.testing.assert_allclose(length, total, rtol=0.02)


def test_a_bones_axes_are_a_rotation_whichever_way_it_points() -> None:
    tree = grow_tree(SPECIES["sapling"], np.random.default_rng(4))
    bones, _ = bones_of(tree)
    down = replace(bones, tail=bones.head - np.array([0, 1, 0], np.float32))
    for one in (bones, down):
        axes = rest_axes(one)
        np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), axes.shape), atol=1e-6)
        np.testing.assert_allclose(np.linalg.det(axes), 1, atol=1e-6)


def test_a_folder_of_trees_is_found_by_itself_or_around_them(samples: Path) -> None:
    assert sapling_files(samples) == sapling_files(samples / "sapling")
