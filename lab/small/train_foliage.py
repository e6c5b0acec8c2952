"""Training of the foliage network: one whole tree per step, in one of eight symmetries."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Complex64, Float16, Float32
from scipy.spatial import cKDTree
from torch import Tensor

from dynamictree.mesh import Surface, connected_parts
from dynamictree.models.small.features import TreeFeatures, turn_features
from dynamictree.models.small.foliage import ARM, ARM_SCALE, NUM_PARTS, FoliageNetwork, foliage_inputs
from dynamictree.models.wind import log_wind_scale
from dynamictree.sparse.level import Pyramid
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import surface_average
from lab.dataset.sapling import LEAF
from lab.dataset.shards import StoredTree
from lab.small.examples import example_of

NUM_LEVELS = 3
STANDARDISED_ON = 40  # number of trees
MIN_DEVIATION = 0.01
BLIND_EVERY = 11
"""Every n-th tree is trained without the surface's moments, since files of voxels have none."""
SIZE_WEIGHT = 0.5  # weight of ln sizes beside parts
SIDES = tuple((axes, (east, north, 1)) for axes in ((0, 1, 2), (1, 0, 2)) for east in (1, -1) for north in (1, -1))
"""Axes and signs of the rotations by 90° about the vertical, and of their mirror images."""
SHORTEST_M = 1e-3
LEAST_SIZE = 1e-5
"""Smallest motion [share of the height]; smaller ones are raised to it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FoliageExample:
    """Features of a tree and targets of its voxels; float16, since many are in memory."""

    scalars: Float16[Tensor, "V S"]
    vectors: Float16[Tensor, "V A 3"]
    surface: Float16[Tensor, "V I"]
    tensors: Float16[Tensor, "V R 3 3"]
    targets: Float16[Tensor, "V O"]
    bare: TreeFeatures  # features without the fields above

    def tree(self) -> TreeFeatures:
        """Return features for the network, without the chain of stems."""
        count = len(self.scalars)
        return replace(
            self.bare,
            scalars=self.scalars.float(),
            vectors=self.vectors.float(),
            chain=torch.empty(count, 0, dtype=torch.int64),
            girth=torch.empty(count, 0),
            surface=self.surface.float(),
            tensors=self.tensors.float(),
        )


def foliage_examples(stored: Iterable[StoredTree], *, resolution: int = 128) -> Iterator[FoliageExample]:
    """Compute features and targets of trees."""
    for one in stored:
        example = example_of(one, resolution, with_mesh=one.seed % BLIND_EVERY != 0)
        tree = example.tree
        bare = replace(
            tree,
            grids=Pyramid(levels=tree.grids.levels[:NUM_LEVELS], parents=tree.grids.parents[: NUM_LEVELS - 1]),
            scalars=torch.empty(0, 0),  # a slice would reference the whole tensor
            vectors=torch.empty(0, 0, 3),
            chain=torch.empty(0, 0, dtype=torch.int64),
            girth=torch.empty(0, 0),
            surface=torch.empty(0, 0),
            tensors=torch.empty(0, 0, 3, 3),
        )
        parts = torch.from_numpy(true_parts(one, one.voxels(resolution).grid))
        targets = torch.cat([parts, log_size(example.spectrum, one.wind)], dim=1)
        yield FoliageExample(
            scalars=tree.scalars.half(),
            vectors=tree.vectors.half(),
            surface=tree.surface.half(),
            tensors=tree.tensors.half(),
            targets=targets.half(),
            bare=bare,
        )


def standardise_foliage(network: FoliageNetwork, trees: Sequence[FoliageExample]) -> None:
    """Set the means and deviations of the inputs and the targets."""
    some = trees[:STANDARDISED_ON]
    inputs = torch.cat([foliage_inputs(one.tree())[::7] for one in some])
    targets = torch.cat([one.targets[::7].float() for one in some])
    network.mean.copy_(inputs.mean(dim=0))
    network.deviation.copy_(inputs.std(dim=0) + MIN_DEVIATION)
    network.told_mean.copy_(targets.mean(dim=0))
    network.told_deviation.copy_(targets.std(dim=0) + MIN_DEVIATION)
    network.told_mean[ARM] = 0  # vectors have mean 0 and one scale for all axes
    network.told_deviation[ARM] = targets[:, ARM].square().mean().sqrt()


def foliage_step(
    network: FoliageNetwork, trees: Sequence[FoliageExample], rng: np.random.Generator
) -> Float32[Tensor, ""]:
    """Return the squared error over one tree's voxels."""
    example = trees[int(rng.integers(len(trees)))]
    axes, signs = SIDES[int(rng.integers(len(SIDES)))]
    targets = example.targets.float()
    targets[:, ARM] = targets[:, ARM][:, list(axes)] * torch.tensor(signs, dtype=torch.float32)
    target = (targets - network.told_mean) / network.told_deviation
    error = (network.standard(turn_features(example.tree(), axes, signs)) - target).square().mean(dim=0)
    return error[:NUM_PARTS].mean() + SIZE_WEIGHT * error[NUM_PARTS:].mean()


def log_size(spectrum: Complex64[Tensor, "V K 3"], wind: Wind) -> Float32[Tensor, "V J"]:
    """Return ln(|c_k| / height) at drag and gust 1; `spectrum` is divided by the height."""
    power = spectrum[:, 1:].abs().square().sum(dim=2)
    return (power + LEAST_SIZE**2).log() / 2 - log_wind_scale(wind)


def true_parts(stored: StoredTree, grid: VoxelGrid) -> Float32[np.ndarray, "V 10"]:
    """Average the vertices' part labels over the surface in each voxel."""
    mesh = stored.mesh()
    at_vertex = _at_vertices(stored, mesh)
    return np.asarray(surface_average(mesh, grid) @ at_vertex, np.float32)


def _at_vertices(stored: StoredTree, mesh: Surface) -> Float32[np.ndarray, "N 10"]:
    vertices, skeleton = mesh.vertices, stored.skeleton()
    leaf = stored.tensors["part"] == LEAF
    piece = connected_parts(mesh.faces, mesh.num_vertices)
    piece = np.unique(piece, return_index=True)[1][piece]  # each piece's first vertex, which is a leaf's base
    base = vertices[piece]
    arm = (vertices - base) * leaf[:, None]
    out = np.linalg.norm(arm, axis=1)
    length = np.zeros(len(vertices))
    np.maximum.at(length, piece, out)
    length = np.maximum(length[piece], SHORTEST_M)
    _, bone = cKDTree(skeleton.position).query(np.where(leaf[:, None], base, vertices))
    scale = ARM_SCALE / mesh.height_m
    columns = [
        leaf,
        out * scale,
        out / length * leaf,
        np.log(length) * leaf,
        skeleton.level[bone],
        np.log(skeleton.stem_length_m[skeleton.stem[bone]]),
        np.log(skeleton.radius[bone]),
        *(arm * scale).T,
    ]
    assert len(columns) == NUM_PARTS
    return np.stack(columns, axis=1).astype(np.float32)
