"""Branching structure of a voxel grid, read from the shortest paths to the root."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from dynamictree.voxel.graph import root_rows
from dynamictree.voxel.grid import VoxelGrid

FOOT_VOXELS = 4
"""So far out, a stem has left the surface of the one that bears it."""


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """Position of each voxel on its stem. A stem continues in the child that reaches furthest."""

    parent: Int32[np.ndarray, " V"]  # next voxel towards the root; a root is its own
    distance_m: Float32[np.ndarray, " V"]  # along the tree to the root [m]
    reach_m: Float32[np.ndarray, " V"]  # from here to the furthest tip beyond [m]
    num_beyond: Float32[np.ndarray, " V"]  # voxels whose way to the root passes here, this one included
    stem_start_m: Float32[np.ndarray, " V"]  # distance_m where the voxel's stem begins [m]
    stem_length_m: Float32[np.ndarray, " V"]  # [m]
    level: Float32[np.ndarray, " V"]  # stems passed on the way from the root; 0 on the trunk
    base: Int32[
        np.ndarray, " V"
    ]  # the voxel on the stem before, from which this voxel's stem grows; a root's is itself
    foot: Int32[np.ndarray, " V"]  # the last voxel on the way here whose stem is not yet FOOT_VOXELS long


def skeleton_of(grid: VoxelGrid, graph: csr_array) -> Skeleton:
    """Read the stems off the graph of touching voxels (edges in metres, connected)."""
    roots = root_rows(graph, grid)
    distance, parent, _ = dijkstra(graph, indices=roots, min_only=True, return_predecessors=True)
    order = np.argsort(distance, kind="stable").tolist()
    parents = np.where(parent < 0, np.arange(len(grid)), parent).tolist()
    tip, beyond, heir = _gather_from_tips(order, parents, distance)
    start, length, level = [0.0] * len(grid), [0.0] * len(grid), [0.0] * len(grid)
    base, foot = list(range(len(grid))), list(range(len(grid)))
    foot_m = FOOT_VOXELS * grid.voxel_size_m
    for row in order:
        up = parents[row]
        if up == row:
            length[row] = tip[row]
        elif heir[up] == row:
            start[row], length[row], level[row], base[row] = start[up], length[up], level[up], base[up]
        else:
            start[row], length[row], level[row] = distance[up], tip[row] - distance[up], level[up] + 1
            base[row] = up
        if heir[up] == row and distance[row] - start[row] >= foot_m:
            foot[row] = foot[up]
    columns = [np.asarray(column, np.float32) for column in (distance, beyond, start, length, level)]
    return Skeleton(
        parent=np.asarray(parents, np.int32),
        distance_m=columns[0],
        reach_m=(np.asarray(tip) - distance).astype(np.float32),
        num_beyond=columns[1],
        stem_start_m=columns[2],
        stem_length_m=columns[3],
        level=columns[4],
        base=np.asarray(base, np.int32),
        foot=np.asarray(foot, np.int32),
    )


def skip_short(skeleton: Skeleton, rows: Int32[np.ndarray, " V"], length_m: float) -> Int32[np.ndarray, " V"]:
    """From each row down to the first stem that is at least so long [m]: a leaf's voxels make stems of their own."""
    max_skips = 12  # stems that `skip_short` goes down at most
    for _ in range(max_skips):
        rows = np.where(skeleton.stem_length_m[rows] < length_m, skeleton.base[rows], rows)
    return rows


def section_radius(
    grid: VoxelGrid,
    graph: csr_array,
    distance_m: Float32[np.ndarray, " V"],
    area_m2: Float64[np.ndarray, " V"] | None,
) -> Float64[np.ndarray, " V"]:
    """Radius of each voxel's cross-section [m].

    A cross-section is what hangs together of the voxels that are about as far from the root along the tree (Verroust
    and Lazarus, Extracting skeletal curves from 3D scattered data, 1999). The RMS distance of its voxels from their
    middle is the radius where they are a ring. A twig thinner than a voxel is no ring: there the surface inside, over
    the length of the section, is its circumference.

    Args:
        grid: of the voxels.
        graph: touching voxels.
        distance_m: along the tree to the root [m].
        area_m2: of the surface in each voxel [m²]; None where no mesh is known.
    """
    thinnest_voxels = 0.01
    section_voxels = 2  # thickness of a cross-section
    slab = (distance_m / (section_voxels * grid.voxel_size_m)).astype(np.int32)
    edges = graph.tocoo()
    inside = slab[edges.row] == slab[edges.col]
    places = edges.row[inside], edges.col[inside]
    within = csr_array((np.ones(len(places[0]), np.int8), places), shape=graph.shape)
    count, section = connected_components(within, directed=False)
    size = np.bincount(section)
    middle = np.stack([np.bincount(section, axis) / size for axis in grid.centres_m.T], axis=1)
    squares = ((grid.centres_m - middle[section]) ** 2).sum(axis=1)
    radius = np.sqrt(np.bincount(section, squares, count) / size) + grid.voxel_size_m / 2
    if area_m2 is not None:
        circumference = np.bincount(section, area_m2, count) / (section_voxels * grid.voxel_size_m)
        radius = np.minimum(radius, np.maximum(circumference / (2 * np.pi), thinnest_voxels * grid.voxel_size_m))
    of_voxel: Float64[np.ndarray, " V"] = radius[section]
    return of_voxel


def _gather_from_tips(
    order: list[int], parents: list[int], distance: np.ndarray
) -> tuple[list[float], list[float], list[int]]:
    tip, beyond, heir = distance.tolist(), [1.0] * len(order), [-1] * len(order)
    for row in reversed(order):
        up = parents[row]
        if up != row:
            beyond[up] += beyond[row]
            if heir[up] < 0 or tip[row] > tip[up]:
                tip[up], heir[up] = max(tip[row], tip[up]), row
    return tip, beyond, heir
