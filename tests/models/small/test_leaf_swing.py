"""Leaves swing about their bases: what turns stays, what would stretch a leaf goes."""

import numpy as np
import pytest
import torch

from dynamictree.models.small.foliage import ARM, ARM_SCALE, NUM_FOLIAGE_VALUES
from dynamictree.models.small.prepared import MAX_LEAF_GAIN, Leaves, leaves_of
from dynamictree.voxel.grid import VoxelGrid

AXES = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]], np.float32)
TWIG, FIRST, SECOND = 0, slice(2, 4), slice(5, 7)  # the voxels of each leaf that are not half the base


@pytest.fixture(scope="module")
def grid() -> VoxelGrid:
    """A voxel of a twig, and two leaves of three voxels that grow from it, eastward and upward."""
    coords = [(20, 20, 20), (21, 20, 20), (22, 20, 20), (23, 20, 20), (20, 20, 21), (20, 20, 22), (20, 20, 23)]
    grid = VoxelGrid.from_coords(np.array(coords, np.int32), origin_m=(0.0, 0.0, 0.0), voxel_size_m=0.1, resolution=128)
    assert sorted(grid.rows_of(np.array(coords, np.int32)).tolist()) == list(range(7))
    return grid


@pytest.fixture(scope="module")
def order(grid: VoxelGrid) -> torch.Tensor:
    """Rows of the twig, of the leaf to the east from inside out, and of the one upward."""
    coords = [(20, 20, 20), *((20 + i, 20, 20) for i in (1, 2, 3)), *((20, 20, 20 + i) for i in (1, 2, 3))]
    return torch.from_numpy(grid.rows_of(np.array(coords, np.int32)).astype(np.int64))


@pytest.fixture(scope="module")
def leaves(grid: VoxelGrid, order: torch.Tensor) -> Leaves:
    foliage_values = torch.zeros(7, NUM_FOLIAGE_VALUES)
    foliage_values[order[1:], 0] = 1
    arm = torch.from_numpy(grid.centres_m - grid.centres_m[order[TWIG]])
    foliage_values[:, ARM] = arm.float() * ARM_SCALE / grid.height_m
    return leaves_of(grid, foliage_values, torch.ones(7), AXES)


def motion_of(order: torch.Tensor, twig: torch.Tensor, beyond: torch.Tensor) -> torch.Tensor:
    """The twig's motion, and the leaves' beyond it by their voxels' distance; spectra [7, 3, 3] in the wind's frame."""
    spectrum = torch.zeros(7, 3, 3, dtype=torch.complex64)
    out = torch.tensor([0.0, 1, 2, 3, 1, 2, 3])
    spectrum[order] = twig + out[:, None, None] * beyond
    return spectrum


def test_a_leaf_that_turns_about_its_base_stays_as_it_was(leaves: Leaves, order: torch.Tensor) -> None:
    twig = torch.randn(1, 3, 3, dtype=torch.complex64)
    east = torch.tensor(AXES @ np.float32([1, 0, 0])).to(torch.complex64)
    beyond = torch.randn(1, 3, 3, dtype=torch.complex64)
    beyond -= (beyond @ east)[..., None] * east  # across the first leaf
    spectrum = motion_of(order, twig, beyond)
    swung = leaves.swing(spectrum)
    torch.testing.assert_close(swung[order[FIRST]], spectrum[order[FIRST]])
    torch.testing.assert_close(swung[order[TWIG]], spectrum[order[TWIG]])


def test_no_leaf_moves_along_itself(leaves: Leaves, order: torch.Tensor) -> None:
    beyond = torch.randn(1, 3, 3, dtype=torch.complex64)
    swung = leaves.swing(motion_of(order, torch.randn(1, 3, 3, dtype=torch.complex64), beyond))
    for part, axis in ((FIRST, [1, 0, 0]), (SECOND, [0, 0, 1])):
        along = (swung[order[part]] - swung[order[TWIG]]) @ torch.tensor(AXES @ np.float32(axis)).to(torch.complex64)
        torch.testing.assert_close(along, torch.zeros(2, 3, dtype=torch.complex64), atol=1e-5, rtol=0)


def test_a_leaf_swings_as_far_as_it_was_drawn_and_leans_no_further(leaves: Leaves, order: torch.Tensor) -> None:
    beyond = torch.full((1, 3, 3), 0.01, dtype=torch.complex64)
    spectrum = motion_of(order, torch.zeros(1, 3, 3), beyond)
    before, after = (one[order[SECOND]].abs().square().sum(dim=2).sqrt() for one in (spectrum, leaves.swing(spectrum)))
    torch.testing.assert_close(after[:, 1:], before[:, 1:])
    assert (after[:, 0] < before[:, 0]).all()


def test_a_motion_along_a_leaf_is_not_made_a_large_swing(leaves: Leaves, order: torch.Tensor) -> None:
    beyond = torch.tensor([1e-4, 0, 1], dtype=torch.complex64).expand(1, 3, 3)  # up, as the second leaf points
    swung = leaves.swing(motion_of(order, torch.zeros(1, 3, 3), beyond))
    assert swung[order[SECOND]].abs().max() <= 3 * MAX_LEAF_GAIN * 1e-4 * 1.001


def test_what_the_ground_holds_does_not_swing(grid: VoxelGrid, leaves: Leaves, order: torch.Tensor) -> None:
    foliage_values = torch.zeros(7, NUM_FOLIAGE_VALUES)
    foliage_values[:, 0] = 1
    foliage_values[:, ARM] = (
        torch.from_numpy(grid.centres_m - grid.centres_m[order[TWIG]]).float() * ARM_SCALE / grid.height_m
    )
    fixed_leaves = leaves_of(grid, foliage_values, torch.zeros(7), AXES)
    spectrum = torch.randn(7, 3, 3, dtype=torch.complex64)
    assert (fixed_leaves.swing(spectrum) == spectrum).all()
    assert (leaves.swing(spectrum) != spectrum).any()
