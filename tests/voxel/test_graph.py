"""voxel_graph and root_rows."""

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.distance import cdist

from dynamictree.voxel.graph import root_rows, voxel_graph
from dynamictree.voxel.grid import VoxelGrid


def grid_of(coords: list[list[int]] | np.ndarray, resolution: int = 32) -> VoxelGrid:
    return VoxelGrid.from_coords(
        np.asarray(coords, np.int32), origin_m=(0.0, 0.0, 0.0), voxel_size_m=0.5, resolution=resolution
    )


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
    assert graph.max() == pytest.approx(5 * 0.5)


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
