"""Laws of the leaves of a cloud: whole green blades on narrow feet, and nothing of stems."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.gaussian.binding import STILL, Binding
from dynamictree.gaussian.leaves import flutter_leaves
from dynamictree.rig.pose import Skeleton, Weights
from dynamictree.rig.rig import Rig
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid
from tests.clouds import cloud_at

GREEN, BROWN = (-0.5, 0.5, -0.5), (0.4, 0.0, -0.4)
STEM, NECK, BLADE, UNDERSIDE, SPUR, BARK = range(1, 7)  # bones; a spur of the stem carries a piece of its bark


@pytest.fixture(scope="module")
def rig_and_places() -> tuple[Rig, np.ndarray, np.ndarray]:
    """A stem of 1 m, and a leaf of 0.1 m at half its height, whose underside has a bone on the stem."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 16), np.linspace(0, 1, 60))
    stem = np.stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), height], axis=2).reshape(-1, 3)
    across, along = np.meshgrid(np.linspace(-0.05, 0.05, 12), np.linspace(0.07, 0.17, 12))
    blade = np.stack([along, across, np.full_like(along, 0.5)], axis=2).reshape(-1, 3)
    neck = np.array([[0.05, 0, 0.5], [0.06, 0.005, 0.5], [0.06, 0, 0.505]])
    is_bark = (stem[:, 2] > 0.26) & (stem[:, 2] < 0.3)
    is_spur = (np.abs(stem[:, 2] - 0.31) < 0.012) & (np.abs(stem[:, 1]) < 0.03) & (stem[:, 0] > 0)
    of_stem = np.where(is_bark, BARK, np.where(is_spur, SPUR, STEM))
    places = np.concatenate([stem, neck, blade, blade - [0, 0, 0.005]]).astype(np.float32)
    bone = np.concatenate([of_stem, np.repeat([NECK, BLADE, UNDERSIDE], [len(neck), len(blade), len(blade)])])
    foot = np.float32(
        [[0, 0, 0], [0, 0, 0], [0.05, 0, 0.5], [0.07, 0, 0.5], [0.07, 0, 0.49], [0.05, 0, 0.3], [0, 0, 0.3]]
    )
    skeleton = Skeleton(
        parent=np.array([-1, 0, STEM, NECK, STEM, STEM, SPUR], np.int32),
        foot_m=foot,
        reach_m=np.full_like(foot, 0.1),
        in_surface=np.arange(7) > 0,
    )
    order = np.argsort(skeleton.depths, kind="stable")
    number = np.argsort(order)
    skeleton = Skeleton(
        parent=np.where(order > 0, number[skeleton.above[order]], -1).astype(np.int32),
        foot_m=foot[order],
        reach_m=skeleton.reach_m,
        in_surface=skeleton.in_surface,
    )
    rows = np.stack([number[bone], number[bone]], axis=1).astype(np.int32)
    carriers = Weights(rows=rows, shares=np.tile(np.float32([1, 0]), (len(rows), 1)))
    turns = np.zeros((7, 1, 3), np.complex64)
    return Rig(skeleton=skeleton, turns=turns, vertices=carriers, voxels=carriers, num_frames=100), places, bone


def bound(places: np.ndarray, colour: tuple[float, float, float]) -> Binding:
    """A Gaussian on each vertex."""
    count = len(places)
    return Binding(
        cloud=cloud_at(places, sh=np.tile(colour, (count, 1, 1))),
        vertices=places,
        triangles=(np.arange(count)[:, None] + [0, 1, 2]).astype(np.int32) % count,
        face_of=np.arange(count, dtype=np.int32),
        weights=np.tile(np.float32([1, 0, 0]), (count, 1)),
    )


@pytest.fixture(scope="module")
def spectrum() -> SparseVoxelSpectrum:
    grid = VoxelGrid(coords=np.zeros((1, 3), np.int32), resolution=8, origin_m=(0.0, 0.0, 0.0), voxel_size_m=1.0)
    return SparseVoxelSpectrum(grid=grid, coefficients=np.zeros((1, 1, 3), np.complex64), foliage=1.0)


def test_a_leaf_is_both_sides_of_a_blade_with_its_stalk(rig_and_places, spectrum: SparseVoxelSpectrum) -> None:
    rig, places, bone = rig_and_places
    binding, flutter = flutter_leaves(bound(places, GREEN), rig, spectrum, 1.0)
    assert binding.leaves is not None
    assert flutter is not None
    of_leaf = np.isin(bone, (NECK, BLADE, UNDERSIDE))
    np.testing.assert_array_equal(binding.leaves.of, np.where(of_leaf, 0, STILL))
    np.testing.assert_allclose(places[binding.leaves.vertex], [[0.05, 0, 0.5]], atol=0.02)
    np.testing.assert_allclose(flutter.direction, [[1, 0, 0]], atol=0.1)
    np.testing.assert_allclose(flutter.share, 1)


def test_wood_has_no_leaves_and_larger_leaves_turn_less(rig_and_places, spectrum: SparseVoxelSpectrum) -> None:
    rig, places, _ = rig_and_places
    binding = bound(places, BROWN)
    assert flutter_leaves(binding, rig, spectrum, 1.0) == (binding, None)
    tall = replace(rig, skeleton=replace(rig.skeleton, foot_m=10 * rig.skeleton.foot_m))
    flutter = flutter_leaves(bound(10 * places, GREEN), tall, spectrum, 2.0)[1]
    assert flutter is not None
    assert 0.2 < flutter.share[0] < 0.6
