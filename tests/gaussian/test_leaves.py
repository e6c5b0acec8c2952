"""Laws of the leaves of a cloud: whole green blades on narrow feet, and nothing of stems."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.gaussian.binding import STILL, Binding
from dynamictree.gaussian.leaves import flutter_leaves
from dynamictree.rig.pose import Skeleton, Weights
from dynamictree.rig.rig import Rig
from tests.clouds import cloud_at, still_spectrum

GREEN, BROWN = (-0.5, 0.5, -0.5), (0.4, 0.0, -0.4)
STEM, NECK, UNDERSIDE, SPUR, BLADE, BARK = range(1, 7)  # bones; a spur of the stem carries a piece of its bark


@pytest.fixture(scope="module")
def plant() -> tuple[Rig, np.ndarray, np.ndarray]:
    """A stem of 1 m, and a leaf of 0.1 m at half its height, whose underside has a bone on the stem."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 16), np.linspace(0, 1, 60))
    stem = np.stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), height], axis=2).reshape(-1, 3)
    x, y = np.meshgrid(np.linspace(0.07, 0.17, 12), np.linspace(-0.05, 0.05, 12))
    blade = np.stack([x, y, np.full_like(x, 0.5)], axis=2).reshape(-1, 3)
    neck = np.array([[0.05, 0, 0.5], [0.06, 0.005, 0.5], [0.06, 0, 0.505]])
    is_spur = (np.abs(stem[:, 2] - 0.31) < 0.012) & (np.abs(stem[:, 1]) < 0.03) & (stem[:, 0] > 0)
    of_stem = np.where(np.abs(stem[:, 2] - 0.28) < 0.02, BARK, np.where(is_spur, SPUR, STEM))
    places = np.concatenate([stem, neck, blade, blade - [0, 0, 0.005]]).astype(np.float32)
    bone = np.concatenate([of_stem, np.repeat([NECK, BLADE, UNDERSIDE], [3, len(blade), len(blade)])]).astype(np.int32)
    foot = np.float32([[0, 0, 0], [0, 0, 0], [0.05, 0, 0.5], *[[0, 0, 0]] * 4])
    parent = np.array([-1, 0, STEM, STEM, STEM, NECK, SPUR], np.int32)
    skeleton = Skeleton(parent=parent, foot_m=foot, reach_m=foot + 1, in_surface=np.arange(7) > 0)
    hung = Weights(rows=np.stack([bone, bone], axis=1), shares=np.tile(np.float32([1, 0]), (len(bone), 1)))
    turns = np.zeros((7, 1, 3), np.complex64)
    return Rig(skeleton=skeleton, turns=turns, vertices=hung, voxels=hung, num_frames=100), places, bone


def bound(places: np.ndarray, bone: np.ndarray, stem: object, rest: object) -> Binding:
    row = np.arange(len(places), dtype=np.int32)
    triangles = np.int32((row[:, None] + np.arange(3)) % len(row))
    weights = np.tile(np.float32([1, 0, 0]), (len(row), 1))
    cloud = cloud_at(places, sh=np.where((bone == STEM)[:, None], stem, rest)[:, None])
    return Binding(cloud=cloud, vertices=places, triangles=triangles, face_of=row, weights=weights)


def test_a_leaf_is_both_sides_of_a_blade_with_its_stalk(plant) -> None:
    rig, places, bone = plant
    binding, flutter = flutter_leaves(bound(places, bone, BROWN, GREEN), rig, still_spectrum(), 1.0)
    np.testing.assert_array_equal(binding.leaves.of, np.where(np.isin(bone, (NECK, BLADE, UNDERSIDE)), 0, STILL))
    np.testing.assert_allclose(places[binding.leaves.vertex], [[0.05, 0, 0.5]], atol=0.02)
    np.testing.assert_allclose(flutter.direction, [[1, 0, 0]], atol=0.1)
    np.testing.assert_allclose(flutter.share, 1)


def test_no_leaves_are_brown_or_in_one_colour_and_larger_leaves_turn_less(plant) -> None:
    rig, places, bone = plant
    for colours in ((GREEN, BROWN), (GREEN, GREEN)):
        assert flutter_leaves(bound(places, bone, *colours), rig, still_spectrum(), 1.0)[1] is None
    tall = replace(rig, skeleton=replace(rig.skeleton, foot_m=10 * rig.skeleton.foot_m))
    assert 0.2 < flutter_leaves(bound(10 * places, bone, BROWN, GREEN), tall, still_spectrum(), 2.0)[1].share[0] < 0.6
