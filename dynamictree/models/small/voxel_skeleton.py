"""Branching structure of a voxel grid, read from the shortest paths to the root."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from dynamictree.parallel import compiled
from dynamictree.voxel.graph import root_rows
from dynamictree.voxel.grid import VoxelGrid

FOOT_VOXELS = 4
"""Length at which a stem has left the surface of the one that bears it [voxels]."""


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """Position of each voxel on its stem. A stem continues in the child that reaches furthest."""

    parent: Int32[np.ndarray, " V"]  # next voxel towards the root; a root is its own
    distance_m: Float32[np.ndarray, " V"]  # distance to the root along the tree [m]
    reach_m: Float32[np.ndarray, " V"]  # distance to the furthest tip beyond [m]
    num_beyond: Float32[np.ndarray, " V"]  # voxels whose way to the root passes here, this one included
    stem_start_m: Float32[np.ndarray, " V"]  # distance_m where the voxel's stem begins [m]
    stem_length_m: Float32[np.ndarray, " V"]  # [m]
    level: Float32[np.ndarray, " V"]  # stems passed on the way from the root; 0 on the trunk
    base: Int32[np.ndarray, " V"]  # voxel of the bearing stem from which this one grows; a root's is itself
    foot: Int32[np.ndarray, " V"]  # last voxel on the way here within FOOT_VOXELS of the stem's start
    first: Int32[np.ndarray, " V"]  # first voxel of the voxel's stem


def skeleton_of(grid: VoxelGrid, graph: csr_array) -> Skeleton:
    """Find the stems in the graph of touching voxels (connected, edges in metres)."""
    roots = root_rows(graph, grid)
    distance, parent, _ = dijkstra(graph, indices=roots, min_only=True, return_predecessors=True)
    own = np.arange(len(grid), dtype=np.int32)
    parent = np.where(parent < 0, own, parent).astype(np.int32)
    tip, beyond = distance.copy(), np.ones(len(grid))
    start, length, level = np.zeros((3, len(grid)))
    base, foot, first = own.copy(), own.copy(), own.copy()
    order = np.argsort(distance, kind="stable")
    _follow_stems(
        order, parent, distance, FOOT_VOXELS * grid.voxel_size_m, tip, beyond, start, length, level, base, foot, first
    )
    return Skeleton(
        parent=parent,
        distance_m=distance.astype(np.float32),
        reach_m=(tip - distance).astype(np.float32),
        num_beyond=beyond.astype(np.float32),
        stem_start_m=start.astype(np.float32),
        stem_length_m=length.astype(np.float32),
        level=level.astype(np.float32),
        base=base,
        foot=foot,
        first=first,
    )


def skip_short(skeleton: Skeleton, rows: Int32[np.ndarray, " V"], length_m: float) -> Int32[np.ndarray, " V"]:
    """Go from each row down to the first stem of at least `length_m`, as voxels of a leaf form short stems."""
    max_skips = 12  # most stems to go down
    for _ in range(max_skips):
        rows = np.where(skeleton.stem_length_m[rows] < length_m, skeleton.base[rows], rows)
    return rows


def section_radius(
    grid: VoxelGrid, graph: csr_array, distance_m: Float32[np.ndarray, " V"], area_m2: Float64[np.ndarray, " V"] | None
) -> Float64[np.ndarray, " V"]:
    """Return the radius of each voxel's cross-section [m].

    A cross-section is a connected set of voxels at about the same distance from the root along the tree (Verroust
    and Lazarus, Extracting skeletal curves from 3D scattered data, 1999). If its voxels form a ring, the radius is
    their RMS distance from the middle. A twig thinner than a voxel is no ring: its circumference is the surface area
    inside (`area_m2`, None without a mesh) over the length of the section.
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


@compiled
@no_type_check  # numba compiles no checked function
def _follow_stems(order, parent, distance, foot_m, tip, beyond, start, length, level, base, foot, first):
    heir = np.full(len(order), -1)
    for row in order[::-1]:
        up = parent[row]
        if up != row:
            beyond[up] += beyond[row]
            if heir[up] < 0 or tip[row] > tip[up]:
                tip[up], heir[up] = max(tip[row], tip[up]), row
    for row in order:
        up = parent[row]
        if up == row:
            length[row] = tip[row]
        elif heir[up] == row:
            start[row], length[row], level[row] = start[up], length[up], level[up]
            base[row], first[row] = base[up], first[up]
        else:
            start[row], length[row], level[row] = distance[up], tip[row] - distance[up], level[up] + 1
            base[row] = up
        if heir[up] == row and distance[row] - start[row] >= foot_m:
            foot[row] = foot[up]
