"""Graph of touching voxels, and the voxels at the tree's roots."""

from collections.abc import Sequence

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Int, Int32, Int64, Shaped

from dynamictree.voxel.grid import VoxelGrid

ROOT_SHARE = 0.02
"""Share of the tree's height; voxels this near to the lowest may be in the ground, see `root_rows`."""


OFFSETS = tuple((x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1))
"""Offsets of the 27 taps of a 3³ kernel, in a dense kernel's memory order; tap 26 - i is opposite to tap i."""
CENTRE = 13

Pair = tuple[Int64[np.ndarray, " _"], Int64[np.ndarray, " _"]]


def neighbour_pairs(
    coords: Int[np.ndarray, "V 3"], offsets: Sequence[tuple[int, int, int]] = OFFSETS[:CENTRE]
) -> list[Pair]:
    """Return rows a and b of voxels with coords[b] = coords[a] + offset, for each offset."""
    border = int(np.abs(offsets).max())  # margin so that neighbours' keys cannot wrap around
    shifted = coords.astype(np.int64) - coords.min(axis=0) + border
    span = int(shifted.max()) + border + 1
    strides = np.array([span * span, span, 1])
    own = shifted @ strides
    order = np.argsort(own, kind="stable")
    keys, pairs = own[order], []
    for step in np.array(offsets) @ strides:
        place = np.minimum(np.searchsorted(keys, own + step), len(keys) - 1)
        rows = np.flatnonzero(keys[place] == own + step)
        pairs.append((rows, order[place[rows]]))
    return pairs


def voxel_graph(grid: VoxelGrid, pairs: Sequence[Pair] | None = None) -> "scipy.sparse.csr_array":
    """Build a connected graph [V, V] of distances between voxels that touch by face, edge or corner [m].

    Separate parts are joined to their nearest part by the shortest gap, until all are connected. `pairs` is the result
    of `neighbour_pairs`, if it is at hand.
    """
    from scipy.sparse.csgraph import connected_components

    pairs = pairs or neighbour_pairs(grid.coords)
    starts, ends = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    while True:
        graph = _graph(grid, starts, ends)
        num_parts, part = connected_components(graph, directed=False)
        if num_parts == 1:
            return graph
        bridges = np.unique(np.sort(shortest_gaps(grid.coords, part.astype(np.int64)), axis=0), axis=1)
        starts, ends = np.concatenate([starts, bridges[0]]), np.concatenate([ends, bridges[1]])


def root_rows(graph: "scipy.sparse.csr_array", grid: VoxelGrid) -> Int32[np.ndarray, " R"]:
    """Find the voxels in the ground: the feet of the tree's trunks.

    Branches may hang to the ground too. From such a tip, the mean path to all other voxels is longer than from the
    foot, since it leads back to the trunk.
    """
    max_detour = 1.05  # largest ratio of a trunk's mean path length to the smallest one
    max_feet = 8  # number of parts near the ground that are tested, the largest first
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
    """Build the graph with both directions of every edge."""
    lengths = np.linalg.norm((grid.coords[starts] - grid.coords[ends]) * grid.voxel_size_m, axis=1).astype(np.float32)
    rows, columns = np.concatenate([starts, ends]), np.concatenate([ends, starts])
    both = scipy.sparse.coo_array((np.tile(lengths, 2), (rows, columns)), shape=(len(grid), len(grid)))
    return both.tocsr()


def shortest_gaps(
    points: Shaped[np.ndarray, "V 3"], part: Int64[np.ndarray, " V"]
) -> tuple[Int64[np.ndarray, " B"], Int64[np.ndarray, " B"]]:
    """Find the shortest gap from each part but the largest to another part: one round of Borůvka's algorithm."""
    # neighbours searched first for a voxel of another part; doubled until one is found
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
        order = np.lexsort((seeking, gap, part[seeking]))  # the first row of each part is its shortest gap
        first = order[np.unique(part[seeking][order], return_index=True)[1]]
        first = first[np.isfinite(gap[first])]
        starts.append(seeking[first])
        ends.append(neighbour[first, best[first]])
        seeking = seeking[~np.isin(part[seeking], part[seeking[first]])]
        count *= 2
    return np.concatenate(starts).astype(np.int64), np.concatenate(ends).astype(np.int64)
