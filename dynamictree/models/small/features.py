"""Input features of the small model: per-voxel features of a tree, and the wind.

Vectors are turned into the wind's frame (downwind, crosswind, up), so that no layer has to learn that the wind may
come from anywhere; two channels give the wind's direction on the grid, so that the kernels' axes have a meaning.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int32, Int64
from torch import Tensor

from dynamictree.models.small.surface_shape import surface_features
from dynamictree.models.small.voxel_skeleton import Skeleton, section_radius, skeleton_of, skip_short
from dynamictree.sparse.level import Pyramid, batch_pyramids, pyramid, turn_pyramid
from dynamictree.sparse.matrices import neighbour_means
from dynamictree.sparse.pool import pool_to
from dynamictree.spectrum import Wind
from dynamictree.voxel.graph import voxel_graph
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.moments import AREA, moments_of_normals
from dynamictree.voxel.voxelize import SurfaceVoxels

NUM_LEVELS = 5  # 128³ to 8³
CHAIN = 4
"""Number of stems whose features a voxel gets: its own, the one that bears it, and so on towards the root."""
NUM_SCALARS = 16 + 4 * CHAIN
ROOT_DISTANCE = 2  # index of a scalar: distance to the root along the tree over the height
NUM_VECTORS = 4 + CHAIN
NUM_FEATURES = NUM_SCALARS + 3 * NUM_VECTORS
NUM_WIND = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Stems:
    """Stems of a tree, the trunk among them; it is one, however many roots it has."""

    of_voxel: Int64[Tensor, " V"]
    base: Int64[Tensor, " S"]  # voxel that a stem grows from, the trunk's own first
    tip: Int64[Tensor, " S"]  # last voxel
    is_trunk: Bool[Tensor, " S"]


@dataclass(frozen=True, kw_only=True, eq=False)
class TreeFeatures:
    """Features of one tree or a batch of trees, without the wind."""

    grids: Pyramid
    scalars: Float32[Tensor, "V S"]
    vectors: Float32[Tensor, "V A 3"]  # components along the grid's axes
    height_m: Float32[Tensor, " B"]
    links: Int64[Tensor, "L 2"]  # rows, and the next rows on the way to the root
    chain: Int64[Tensor, "V C"]  # rows where the way to the root enters each of CHAIN stems, and the feet of these
    girth: Float32[Tensor, "V C"]  # ln of the radius of the cross-section at these [m]
    surface: Float32[Tensor, "V I"]  # see `surface_features`; nodes have none
    tensors: Float32[Tensor, "V R 3 3"]  # components along the grid's axes
    stems: Stems | None = None  # nodes and batches have none


def tree_features(voxels: SurfaceVoxels) -> TreeFeatures:
    """Compute the features of a voxelized tree."""
    grid, normals = voxels.grid, voxels.normals
    grids = pyramid(torch.from_numpy(grid.coords.astype(np.int64)), NUM_LEVELS)
    has_moments = voxels.moments is not None
    moments = moments_of_normals(normals) if voxels.moments is None else voxels.moments
    area_m2 = moments[:, AREA][:, 0].astype(np.float64) * grid.voxel_size_m**2 if has_moments else None
    height_m = grid.height_m
    with ThreadPoolExecutor(1) as pool:  # surface and skeleton run in parallel
        seen = pool.submit(surface_features, grid, moments, neighbour_means(grids.levels[0]), has_moments=has_moments)
        graph = voxel_graph(grid, [(first.numpy(), second.numpy()) for first, second in grids.levels[0].pairs])
        skeleton = skeleton_of(grid, graph)
        chain = _chain(grid, skeleton)
        chain_scalars, chain_vectors = _along_chain(grid, skeleton, chain, height_m)
        scalars = np.concatenate([_scalars(grid, skeleton, height_m), _voxel_counts(grids), chain_scalars], axis=1)
        own_vectors = np.stack([*_vectors(grid, skeleton, height_m), normals], axis=1)
        vectors = np.concatenate([own_vectors, chain_vectors], axis=1)
        chain = np.concatenate([chain, skeleton.foot[chain]], axis=1)
        girth = np.log(section_radius(grid, graph, skeleton.distance_m, area_m2))[chain]
        surface, tensors = seen.result()
    carried = np.flatnonzero(skeleton.parent != np.arange(len(grid)))
    return TreeFeatures(
        grids=grids,
        scalars=torch.from_numpy(scalars.astype(np.float32)),
        vectors=torch.from_numpy(vectors.astype(np.float32)),
        height_m=torch.tensor([height_m], dtype=torch.float32),
        links=torch.from_numpy(np.stack([carried, skeleton.parent[carried]], axis=1).astype(np.int64)),
        chain=torch.from_numpy(chain.astype(np.int64)),
        girth=torch.from_numpy(girth.astype(np.float32)),
        surface=torch.from_numpy(surface),
        tensors=torch.from_numpy(tensors),
        stems=_stems(skeleton),
    )


def batch_features(trees: Sequence[TreeFeatures]) -> TreeFeatures:
    """Concatenate several trees to one batch."""
    starts = np.cumsum([0, *(len(tree.scalars) for tree in trees[:-1])]).tolist()
    return TreeFeatures(
        grids=batch_pyramids([tree.grids for tree in trees]),
        scalars=torch.cat([tree.scalars for tree in trees]),
        vectors=torch.cat([tree.vectors for tree in trees]),
        height_m=torch.cat([tree.height_m for tree in trees]),
        links=torch.cat([tree.links + start for tree, start in zip(trees, starts, strict=True)]),
        chain=torch.cat([tree.chain + start for tree, start in zip(trees, starts, strict=True)]),
        girth=torch.cat([tree.girth for tree in trees]),
        surface=torch.cat([tree.surface for tree in trees]),
        tensors=torch.cat([tree.tensors for tree in trees]),
    )


def turn_features(tree: TreeFeatures, axes: tuple[int, int, int], signs: tuple[int, int, int]) -> TreeFeatures:
    """Turn a tree by steps of 90° or mirror it, exactly: new axis i is old axis `axes[i]` times `signs[i]`."""
    sign = torch.tensor(signs, dtype=tree.vectors.dtype)
    vectors = tree.vectors[..., list(axes)] * sign
    tensors = tree.tensors[..., list(axes), :][..., list(axes)] * sign[:, None] * sign
    return replace(tree, grids=turn_pyramid(tree.grids, axes, signs), vectors=vectors, tensors=tensors)


def coarsen_features(tree: TreeFeatures, top: int) -> TreeFeatures:
    """Return the trees on level `top` and above, with features averaged over the voxels of each node."""
    grids = Pyramid(levels=tree.grids.levels[top:], parents=tree.grids.parents[top:])
    scalars, vectors = (pool_to(rows, tree.grids, top) for rows in (tree.scalars, tree.vectors))
    links = tree.grids.rows_above(top)[tree.links]
    links = links[links[:, 0] != links[:, 1]]
    count = len(grids.levels[0])
    return TreeFeatures(
        grids=grids,
        scalars=scalars,
        vectors=vectors,
        height_m=tree.height_m,
        links=links,
        chain=torch.zeros(count, 0, dtype=torch.int64),
        girth=torch.zeros(count, 0),
        surface=torch.zeros(count, 0),
        tensors=torch.zeros(count, 0, 3, 3),
    )


def wind_vector(winds: Sequence[Wind]) -> Float32[Tensor, "B 4"]:
    """Return ln speed, gust, and the direction as a unit vector on the grid."""
    angles = [math.radians(wind.direction_deg) for wind in winds]
    rows = [
        (math.log(max(wind.speed_m_s, 0.1)), wind.gust, math.cos(angle), math.sin(angle))
        for wind, angle in zip(winds, angles, strict=True)
    ]
    return torch.tensor(rows, dtype=torch.float32)


def node_features(tree: TreeFeatures, wind: Float32[Tensor, "B 4"]) -> Float32[Tensor, "V F"]:
    """Return all features of each voxel, with vectors in the wind's frame."""
    sample = tree.grids.levels[0].sample_of_row
    cosine, sine = wind[sample, 2, None], wind[sample, 3, None]  # [V, 1]
    east, north = tree.vectors[..., 0], tree.vectors[..., 1]  # [V, A]
    downwind, crosswind = cosine * east + sine * north, cosine * north - sine * east
    return torch.cat([tree.scalars, downwind, crosswind, tree.vectors[..., 2]], dim=1)


def _scalars(grid: VoxelGrid, skeleton: Skeleton, height_m: float) -> Float32[np.ndarray, "V 12"]:
    above = (grid.coords[:, 2] - grid.coords[:, 2].min() + 0.5) * grid.voxel_size_m
    along = skeleton.distance_m - skeleton.stem_start_m
    columns = [
        above / height_m,
        np.log(above),
        skeleton.distance_m / height_m,
        np.log(skeleton.distance_m + 0.1),
        skeleton.reach_m / height_m,
        np.log(skeleton.reach_m + grid.voxel_size_m),
        np.log(skeleton.num_beyond) / 3,
        np.log(skeleton.stem_length_m + grid.voxel_size_m),
        along / (skeleton.stem_length_m + grid.voxel_size_m),
        np.minimum(skeleton.level, 12) / 6,
        np.full(len(grid), math.log(height_m)),
        np.full(len(grid), math.log(grid.voxel_size_m) + 2),
    ]
    return np.stack(columns, axis=1).astype(np.float32)


def _stems(skeleton: Skeleton) -> Stems:
    trunk = skeleton.level == 0
    main = int(np.where(trunk, skeleton.num_beyond, 0).argmax())
    first, of_voxel = np.unique(np.where(trunk, main, skeleton.first), return_inverse=True)
    tip = np.empty(len(first), np.int64)
    by_distance = np.argsort(np.where(trunk & (skeleton.first != main), -1, skeleton.distance_m), kind="stable")
    tip[of_voxel[by_distance]] = by_distance  # the last assignment is the furthest voxel
    return Stems(
        of_voxel=torch.from_numpy(of_voxel.astype(np.int64)),
        base=torch.from_numpy(np.where(first == main, main, skeleton.base[first]).astype(np.int64)),
        tip=torch.from_numpy(tip),
        is_trunk=torch.from_numpy(first == main),
    )


def _chain(grid: VoxelGrid, skeleton: Skeleton) -> Int32[np.ndarray, "V 4"]:
    """Return the rows where the way from each voxel to the root enters its own stem and those that bear it."""
    shortest_stem = 4  # voxels
    shortest_m = shortest_stem * grid.voxel_size_m
    rows = [skip_short(skeleton, np.arange(len(grid), dtype=np.int32), shortest_m)]
    while len(rows) < CHAIN:
        rows.append(skip_short(skeleton, skeleton.base[rows[-1]], shortest_m))
    return np.stack(rows, axis=1)


def _along_chain(
    grid: VoxelGrid, skeleton: Skeleton, chain: Int32[np.ndarray, "V 4"], height_m: float
) -> tuple[Float32[np.ndarray, "V 16"], Float32[np.ndarray, "V 4 3"]]:
    """Describe the stems between a voxel and the root: length, place along them, number of voxels beyond, lever arm."""
    voxel, centres = grid.voxel_size_m, grid.centres_m
    scalars, vectors = [], []
    for rows in chain.T:
        base, length = skeleton.base[rows], skeleton.stem_length_m[rows] + voxel
        along = skeleton.distance_m[rows] - skeleton.stem_start_m[rows] + voxel
        scalars += [np.log(length), np.log(along / length)]
        scalars += [np.log1p(skeleton.num_beyond[place]) / 3 for place in (base, rows)]
        vectors.append((centres - centres[base]) / height_m)
    return np.stack(scalars, axis=1).astype(np.float32), np.stack(vectors, axis=1).astype(np.float32)


def _voxel_counts(grids: Pyramid) -> Float32[np.ndarray, "V 4"]:
    """Return logarithms of the number of touching voxels, and of voxels per ancestor at three coarser levels."""
    level = grids.levels[0]
    touching = torch.bincount(torch.cat([side for pair in level.pairs for side in pair]), minlength=len(level))
    columns = [torch.log1p(touching.float()) / 2]
    for top in (1, 2, 3):
        ancestor = grids.rows_above(top)
        columns.append(torch.log(torch.bincount(ancestor)[ancestor].float()) / 2)
    return torch.stack(columns, dim=1).numpy()


def _vectors(grid: VoxelGrid, skeleton: Skeleton, height_m: float) -> list[Float32[np.ndarray, "V 3"]]:
    """Return per voxel the vector from the foot, the axis of its stem, and the axis four times as far down."""
    axis_steps = 6  # voxels down to the ancestor from which the stem's axis points
    centres = grid.centres_m
    foot = centres[skeleton.distance_m == 0].mean(axis=0)
    vectors = [(centres - foot) / height_m]
    ancestor = np.arange(len(grid))
    for _ in range(2):
        for _ in range(axis_steps if len(vectors) == 1 else 3 * axis_steps):
            ancestor = skeleton.parent[ancestor]
        axis = centres - centres[ancestor]
        vectors.append(axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-6))
    return vectors
