"""The voxel grid: order, look-up, frames that nest, its graph and roots."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.distance import cdist

from dynamictree.errors import InputError
from dynamictree.voxel.graph import root_rows, voxel_graph
from dynamictree.voxel.grid import VoxelGrid, grid_frame


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


def test_edges_are_those_of_a_slow_search_over_26_neighbours(rng) -> None:
    grid = grid_of(rng.integers(0, 6, (150, 3)))  # dense enough to hang together
    steps = np.abs(grid.coords[:, None] - grid.coords[None]).max(axis=2)
    expected = np.where(steps == 1, cdist(grid.centres_m, grid.centres_m), 0)
    np.testing.assert_allclose(voxel_graph(grid).toarray(), expected, rtol=1e-6)


def test_a_graph_of_many_parts_is_made_one_by_shortest_gaps(rng) -> None:
    grid = grid_of(rng.integers(0, 32, (300, 3)))
    graph = voxel_graph(grid)
    assert connected_components(graph, directed=False)[0] == 1
    assert (abs(graph - graph.T) > 0).nnz == 0
    # a bridge is never longer than the longest edge of the minimum spanning tree of all voxels
    longest = minimum_spanning_tree(cdist(grid.centres_m, grid.centres_m)).max()
    assert graph.max() == pytest.approx(longest, rel=1e-6)


def test_two_large_parts_are_joined_by_one_bridge() -> None:
    graph = voxel_graph(grid_of([[x, 0, 0] for x in (*range(10), *range(14, 32))]))
    assert graph.nnz == 2 * (9 + 17 + 1)
    assert graph.max() == pytest.approx(5 * 0.25)


def hanging_tree(foot: int, tip: int) -> VoxelGrid:
    """A trunk, a branch across at its top, and a twig that hangs from the branch's end; sides of both in voxels."""
    trunk = [[x, y, z] for x in range(foot) for y in range(foot) for z in range(20)]
    across = [[x, 0, 19] for x in range(foot, 12)]
    hanging = [[x, y, z] for x in range(12, 12 + tip) for y in range(tip) for z in range(20)]
    return grid_of(trunk + across + hanging)


@pytest.mark.parametrize(("foot", "tip"), [(2, 1), (1, 1)])
def test_the_tip_of_a_branch_that_hangs_to_the_ground_is_no_root(foot: int, tip: int) -> None:
    grid = hanging_tree(foot, tip)
    if foot == tip:  # as thick as the trunk: what else the trunk bears tells them apart
        grid = grid_of(np.concatenate([grid.coords, [[0, y, z] for y in range(1, 20) for z in (5, 10)]]))
    coords = grid.coords[root_rows(voxel_graph(grid), grid)]
    assert (coords[:, 2] == 0).all()
    assert coords[:, 0].max() < foot


def test_two_trunks_that_meet_above_are_both_roots() -> None:
    coords = (grid := hanging_tree(2, 2)).coords[root_rows(voxel_graph(grid), grid)]
    assert sorted(set(coords[:, 0].tolist())) == [0, 1, 12, 13]


def test_one_voxel_is_a_graph_and_its_own_root() -> None:
    grid = grid_of([[3, 3, 3]])
    graph = voxel_graph(grid)
    assert graph.nnz == 0
    np.testing.assert_array_equal(root_rows(graph, grid), [0])
