"""The voxel grid: order, look-up, frames that nest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamictree.errors import InputError
from dynamictree.voxel.grid import VoxelGrid, distinct, grid_frame


def grid_of(coords: np.ndarray | list[list[int]], **options: object) -> VoxelGrid:
    frame = {"origin_m": (-1.0, 0.5, 2.0), "voxel_size_m": 0.25, "resolution": 32} | options
    return VoxelGrid.from_coords(np.array(coords, np.int32).reshape(-1, 3), **frame)


def test_voxels_are_in_ascending_order_of_x_y_z_each_once(rng) -> None:
    coords = rng.integers(0, 32, (500, 3))
    grid = grid_of(coords)
    assert [tuple(c) for c in grid.coords.tolist()] == sorted({tuple(c) for c in coords.tolist()})
    assert (np.diff(grid.keys) > 0).all()
    assert len(grid) == len(grid.coords)


def test_a_voxel_s_centre_lies_in_it(rng) -> None:
    grid = grid_of(rng.integers(0, 32, (200, 3)))
    np.testing.assert_array_equal(grid.coords_of(grid.centres_m), grid.coords)
    np.testing.assert_array_equal(grid.rows_of(grid.coords), np.arange(len(grid)))
    np.testing.assert_allclose(grid_of([[0, 0, 0]]).centres_m, [[-0.875, 0.625, 2.125]])


def test_rows_of_voxels_that_are_not_there_are_minus_one() -> None:
    grid = grid_of([[0, 0, 0], [31, 31, 31]])
    wanted = np.array([[31, 31, 31], [0, 0, 1], [-1, 31, 31], [32, 0, 0], [0, 0, -1], [0, 32, 0]], np.int32)
    np.testing.assert_array_equal(grid.rows_of(wanted), [1, -1, -1, -1, -1, -1])


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32), scale=st.sampled_from([1e-3, 1.0, 1e3]), resolution=st.sampled_from([32, 128, 512]))
def test_the_frame_holds_all_points_and_stands_centred_under_them(seed: int, scale: float, resolution: int) -> None:
    points = (np.random.default_rng(seed).normal(size=(50, 3)) * scale + 5 * scale).astype(np.float32)
    origin, size = grid_frame(points, resolution)
    in_voxels = (points - np.array(origin)) / size
    assert in_voxels.min() > 0
    assert in_voxels.max() < resolution
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    np.testing.assert_allclose(np.array(origin)[:2] + size * resolution / 2, middle[:2], atol=1e-4 * scale)
    assert in_voxels[:, 2].min() < 0.02 * resolution


@pytest.mark.parametrize("resolution", [32, 64, 128, 256])
def test_frames_of_twice_the_resolution_nest_exactly(rng, resolution: int) -> None:
    points = rng.normal(size=(50, 3)).astype(np.float32)
    origin, size = grid_frame(points, resolution)
    fine_origin, fine_size = grid_frame(points, 2 * resolution)
    assert fine_origin == origin
    assert fine_size * 2 == size


@pytest.mark.parametrize(
    ("coords", "options", "message"),
    [
        ([], {}, "empty"),
        ([[0, 0, 32]], {}, "0 to 31"),
        ([[0, -1, 0]], {}, "0 to 31"),
        ([[0, 0, 0]], {"voxel_size_m": 0.0}, "voxel_size_m is 0"),
        ([[0, 0, 0]], {"voxel_size_m": np.inf}, "voxel_size_m is inf"),
        ([[0, 0, 1], [0, 0, 0]], {}, "ascending"),
        ([[0, 0, 1], [0, 0, 1]], {}, "unique"),
    ],
)
def test_a_grid_that_cannot_be_is_refused(coords: list[list[int]], options: dict, message: str) -> None:
    frame = {"origin_m": (0.0, 0.0, 0.0), "voxel_size_m": 0.25, "resolution": 32} | options
    with pytest.raises(InputError, match=message):
        VoxelGrid(coords=np.array(coords, np.int32).reshape(-1, 3), **frame)


def test_distinct_keys_are_those_of_numpy(rng) -> None:
    for keys in (rng.integers(-50, 50, 400), np.zeros(3, np.int64), np.zeros(0, np.int64)):
        np.testing.assert_array_equal(distinct(keys), np.unique(keys))
