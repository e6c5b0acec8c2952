"""Deterministic part of sampling, precomputed for one tree and one wind."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex64, Float32
from scipy.sparse import csr_array
from torch import Tensor

from dynamictree.diffusion.channels import unpack_channels
from dynamictree.models.small.amplitude import above_floor
from dynamictree.models.small.features import (
    NUM_WIND,
    ROOT_DISTANCE,
    TreeFeatures,
    coarsen_features,
    tree_features,
    wind_vector,
)
from dynamictree.models.small.mixer import Neighbourhood, neighbourhood
from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.small.spread import at_speed, with_spread
from dynamictree.models.small.stem_noise import StemNoise, stem_noise
from dynamictree.models.voxel_resolution import coarsened, halvings_served
from dynamictree.models.wind import wind_axes
from dynamictree.sparse.matrices import SparseRows, neighbour_means, sparse_rows, upsample_matrix
from dynamictree.sparse.pool import pool_to
from dynamictree.spectrum import Wind
from dynamictree.voxel.voxelize import SurfaceVoxels

MAX_NETWORK_VOXELS = 150_000
"""Most voxels that the network reads; a denser tree is generated on a grid twice as coarse, and interpolated. Trees of
the dataset have 8,000 to 35,000. Memory and time grow linearly: 6 kB per voxel (docs/decisions)."""
LEAF_SHARES = (0.2, 0.4)
"""Mean share of leaf per voxel: the most for a bare tree, and the least for one in leaf. Six grown bare trees of 1 to
30 m have 0.03 to 0.15, thirteen of other species 0.51 to 0.80."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedTree:
    """Precomputed data of a tree for the sampler and for the steps after it."""

    voxels: SurfaceVoxels  # input of the network
    nodes: TreeFeatures
    wind: Float32[Tensor, "1 4"]
    noise: StemNoise
    neighbourhood: Neighbourhood
    node_log_amplitude: Float32[Tensor, "W J 3"]
    lean: Float32[Tensor, "V 3"]  # over the height
    amplitude: Float32[Tensor, "V J 3"]  # root mean square over the height
    spread: Float32[Tensor, "J 3"]  # spread of sizes about the amplitude
    lift: SparseRows  # [V, W] from nodes to voxels
    axes: Float32[np.ndarray, "3 3"]  # rows are downwind, crosswind, up
    height_m: float
    foliage: float | None  # 0 is bare, 1 in leaf; None if unknown
    finer: csr_array | None  # interpolation to the requested grid, if that is finer than the network's

    def assemble(
        self, start: Float32[Tensor, "V J 6"], whitened: Float32[Tensor, "W J 6"]
    ) -> Complex64[Tensor, "V K 3"]:
        """Combine lean and sway by the network's formula: over the height, in the wind's frame.

        `start` is the noise at the voxels, `whitened` what the sampler made of it on the nodes.
        """
        change = self.lift.apply(whitened - self.noise.pool.apply(start))
        moving = with_spread(unpack_channels(start + change), self.spread) * self.amplitude
        return torch.cat([self.lean[:, None].to(moving.dtype), moving], dim=1)

    def to_metres(self, relative: Complex64[Tensor, "V K 3"]) -> Complex64[np.ndarray, "X K 3"]:
        """Convert to the tree's own frame, on the requested grid [m]."""
        coefficients = relative.numpy() @ self.axes * self.height_m
        if self.finer is not None:
            raised = self.finer @ coefficients.reshape(len(coefficients), -1)
            coefficients = raised.reshape(-1, *coefficients.shape[1:])
        return np.ascontiguousarray(coefficients.astype(np.complex64))


def foliage_of(foliage_values: Float32[Tensor, "V O"]) -> float:
    """Estimate the foliage, from bare (0) to in leaf (1), by the mean share of leaf per voxel."""
    low, high = LEAF_SHARES
    share = float(foliage_values[:, 0].clamp(0, 1).mean())
    return min(max((share - low) / (high - low), 0.0), 1.0)


def prepare_tree(
    network: SmallNetwork, voxels: SurfaceVoxels, wind: Wind, *, max_voxels: int = MAX_NETWORK_VOXELS
) -> PreparedTree:
    """Compute features, amplitudes and interpolation matrices of a tree."""
    # share of the height, along the tree from the roots, over which the ground fixes the stem
    fixed_share = 0.02
    halvings = halvings_served(voxels.grid, network.preset.resolution, "small", max_voxels=max_voxels)
    coarse, finer = coarsened(voxels, halvings)
    tree, air, top = tree_features(coarse), wind_vector([wind]), network.preset.top
    height_m, axes = float(tree.height_m[0]), wind_axes(wind)
    nodes = coarsen_features(tree, top)
    foliage_values = network.foliage(tree)
    lean, log_amplitude = network.amplitude.of_tree(tree, foliage_values, air)
    rms = above_floor(log_amplitude, air[:, :NUM_WIND]) * at_speed(network.log_gain, air[0, 0]).exp()
    free = 1 - (-(tree.scalars[:, ROOT_DISTANCE] / fixed_share).square()).exp()  # [V]
    return PreparedTree(
        voxels=coarse,
        nodes=nodes,
        wind=air,
        noise=stem_noise(tree, log_amplitude, air, network.common_share, foliage_values[:, 0].clamp(0, 1), top),
        neighbourhood=neighbourhood(nodes),
        node_log_amplitude=pool_to(log_amplitude, tree.grids, top),
        lean=sparse_rows(neighbour_means(tree.grids.levels[0])).apply(lean) * free[:, None],
        amplitude=rms * free[:, None, None],
        spread=at_speed(network.spread, air[0, 0]),
        lift=sparse_rows(upsample_matrix(tree.grids, top, 0)),
        axes=axes,
        height_m=height_m,
        foliage=None if coarse.moments is None else foliage_of(foliage_values),
        finer=finer,
    )
