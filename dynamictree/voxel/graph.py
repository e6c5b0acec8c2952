"""Graph of touching voxels, and those where the tree stands."""

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Int32, Int64, Shaped

from dynamictree.voxel.grid import VoxelGrid, distinct

ROOT_SHARE = 0.02
"""Of the tree's height: voxels this near to the lowest may stand in the ground, see `root_rows`."""


_STEPS = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], np.int32)


def voxel_graph(grid: VoxelGrid) -> "scipy.sparse.csr_array":
    """Distances [V, V] between voxels that touch by face, edge or corner, made connected [m].

    Parts that touch no other are joined to their nearest neighbour part by the shortest gap, until all is one.
    """
    half_of_steps = _STEPS[14:]  # one of each pair of opposite directions
    from scipy.sparse.csgraph import connected_components

    starts, ends = [], []
    for step in half_of_steps:
        neighbours = grid.rows_of(grid.coords + step)
        occupied = np.flatnonzero(neighbours >= 0)
        starts.append(occupied)
        ends.append(neighbours[occupied].astype(np.int64))
    graph = _graph(grid, np.concatenate(starts), np.concatenate(ends))
    while True:
        num_parts, part = connected_components(graph, directed=False)
        if num_parts == 1:
            return graph
        bridge_starts, bridge_ends = shortest_gaps(grid.coords, part.astype(np.int64))
        coo = graph.tocoo()
        graph = _graph(grid, np.concatenate([coo.row, bridge_starts]), np.concatenate([coo.col, bridge_ends]))


def root_rows(graph: "scipy.sparse.csr_array", grid: VoxelGrid) -> Int32[np.ndarray, " R"]:
    """Voxels that stand in the ground: the tree's foot, and those of other trunks.

    Branches that hang to the ground end there too. From such a tip, the way to all else is longer than from the foot
    that bears it: it leads back up to the trunk.
    """
    max_detour = 1.05  # how much further, in the mean, all else may be from another trunk than from the foremost
    max_feet = 8  # parts near the ground that are looked at, the largest
    from scipy.sparse.csgraph import connected_components, dijkstra

    height = grid.coords[:, 2]
    low = np.flatnonzero(height <= height.min() + ROOT_SHARE * max(int(np.ptp(height)), 1)).astype(np.int32)
    num_parts, part = connected_components(graph[low][:, low], directed=False)
    if num_parts == 1:
        return low
    largest = np.argsort(-np.bincount(part), kind="stable")[:max_feet]
    ways = [dijkstra(graph, directed=False, indices=low[part == one], min_only=True).mean() for one in largest]
    feet = largest[np.asarray(ways) <= max_detour * min(ways)]
    return low[np.isin(part, feet)]


def _graph(grid: VoxelGrid, starts: Int64[np.ndarray, " E"], ends: Int64[np.ndarray, " E"]) -> "scipy.sparse.csr_array":
    """Both directions of every edge, each once, in a fixed order."""
    low, high = np.minimum(starts, ends).astype(np.int64), np.maximum(starts, ends).astype(np.int64)
    keys = distinct(low * len(grid) + high)
    low, high = keys // len(grid), keys % len(grid)
    lengths = np.linalg.norm((grid.coords[low] - grid.coords[high]) * grid.voxel_size_m, axis=1).astype(np.float32)
    rows, columns = np.concatenate([low, high]), np.concatenate([high, low])
    both = scipy.sparse.coo_array((np.tile(lengths, 2), (rows, columns)), shape=(len(grid), len(grid)))
    return both.tocsr()


def shortest_gaps(
    points: Shaped[np.ndarray, "V 3"], part: Int64[np.ndarray, " V"]
) -> tuple[Int64[np.ndarray, " B"], Int64[np.ndarray, " B"]]:
    """From every part but the largest, the pair of points nearest to another part: a round of Borůvka's algorithm."""
    # looked at first when a component seeks the nearest voxel of another; doubled until one is found
    first_neighbours = 16
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    largest = int(np.argmax(np.bincount(part)))
    seeking = np.flatnonzero(part != largest)
    count = first_neighbours
    starts, ends = [], []
    while len(seeking):
        distances, neighbours = tree.query(points[seeking], k=min(count, len(points)))
        neighbour = np.asarray(neighbours)
        distance = np.where(part[neighbour] == part[seeking][:, None], np.inf, distances)  # [M, count]
        best = np.argmin(distance, axis=1)
        gap = distance[np.arange(len(seeking)), best]
        order = np.lexsort((seeking, gap, part[seeking]))  # the first of each part is its shortest gap
        first = order[np.unique(part[seeking][order], return_index=True)[1]]
        first = first[np.isfinite(gap[first])]
        starts.append(seeking[first])
        ends.append(neighbour[first, best[first]])
        seeking = seeking[~np.isin(part[seeking], part[seeking[first]])]
        count *= 2
    return np.concatenate(starts).astype(np.int64), np.concatenate(ends).astype(np.int64)
