"""Deterministic part of sampling, precomputed for one tree and one wind."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Int64
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from torch import Tensor

from dynamictree.diffusion.channels import unpack_channels
from dynamictree.models.small.amplitude import above_floor
from dynamictree.models.small.correlated_noise import NoiseBasis, noise_basis
from dynamictree.models.small.features import (
    NUM_WIND,
    ROOT_DISTANCE,
    TreeFeatures,
    coarsen_features,
    tree_features,
    wind_vector,
)
from dynamictree.models.small.foliage import ARM, ARM_SCALE
from dynamictree.models.small.mixer import Neighbourhood, neighbourhood
from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.small.spread import at_speed, squared_magnitude, to_unit_power, with_spread
from dynamictree.models.voxel_resolution import coarsened, halvings_served
from dynamictree.models.wind import wind_axes
from dynamictree.sparse.matrices import SparseRows, neighbour_means, sparse_rows, unit_rows, upsample_matrix
from dynamictree.sparse.pool import pool_to
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

MAX_LEAF_GAIN = 2.0
MAX_NETWORK_VOXELS = 150_000
"""Most voxels that the network reads; a denser tree is generated on a grid twice as coarse, and interpolated. Trees of
the dataset have 8,000 to 35,000. Memory and time grow linearly: 6 kB per voxel (docs/decisions)."""
LEAF_SHARES = (0.2, 0.4)
"""Mean share of leaf per voxel: the most for a bare tree, and the least for one in leaf. Six grown bare trees of 1 to
30 m have 0.03 to 0.15, thirteen of other species 0.51 to 0.80."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Leaves:
    """Leaf of each voxel: base, direction and weight, to project its motion relative to its base onto rotations.

    Sizes and phases are drawn per axis, so a leaf would grow and shrink along itself; restoring its lengths on the mesh
    would then remove flutter. The component along the leaf is removed, and the one across it rescaled.
    """

    base: Int64[Tensor, " V"]  # voxel that the leaf grows from; for wood, the voxel itself
    outward: Float32[Tensor, "V 3"]  # unit vector from the base to the voxel
    share: Float32[Tensor, " V"]  # 0 on wood and at a leaf's base

    def swing(self, spectrum: Complex64[Tensor, "V K 3"]) -> Complex64[Tensor, "V K 3"]:
        """Replace the leaves' motion by rotations about their bases; the mean pose (k = 0) does not grow."""
        beyond = spectrum - spectrum[self.base]
        outward = self.outward[:, None].to(spectrum.dtype)
        across = beyond - (beyond * outward).sum(dim=2, keepdim=True) * outward
        gain = (_size(beyond) / _size(across).clamp_min(torch.finfo(torch.float32).tiny)).clamp_max(MAX_LEAF_GAIN)
        gain[:, 0] = 1
        return spectrum + self.share[:, None, None] * (gain[..., None] * across - beyond)


def leaves_of(
    grid: VoxelGrid,
    foliage_values: Float32[Tensor, "V O"],
    free: Float32[Tensor, " V"],
    axes: Float32[np.ndarray, "3 3"],
) -> Leaves:
    """Build the leaves from the foliage network's output; `free` is 0 where the ground fixes a voxel, 1 elsewhere."""
    # distance from the leaf's base below which a voxel's motion does not change; one voxel further it swings in full
    base_voxels = 0.5
    # vector from the base of each voxel's leaf to the voxel [voxels]; about 0 on wood
    arm = foliage_values[:, ARM].numpy() * ((int(np.ptp(grid.coords[:, 2])) + 1) / ARM_SCALE)
    length = np.linalg.norm(arm, axis=1)
    outward = arm @ axes.T / np.maximum(length, np.finfo(np.float32).tiny)[:, None]
    out = (length - base_voxels).clip(0, 1)
    return Leaves(
        base=torch.from_numpy(np.asarray(cKDTree(grid.coords).query(grid.coords - arm)[1], np.int64)),
        outward=torch.from_numpy(outward.astype(np.float32)),
        share=free * foliage_values[:, 0].clamp(0, 1) * torch.from_numpy(out.astype(np.float32)),
    )


def _size(vectors: Complex64[Tensor, "V K 3"]) -> Float32[Tensor, "V K"]:
    return squared_magnitude(vectors).sum(dim=2).sqrt()


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedTree:
    """Precomputed data of a tree for the sampler and for the steps after it."""

    voxels: SurfaceVoxels  # input of the network
    nodes: TreeFeatures
    wind: Float32[Tensor, "1 4"]
    noise: NoiseBasis
    neighbourhood: Neighbourhood
    node_log_amplitude: Float32[Tensor, "W J 3"]
    lean: Float32[Tensor, "V 3"]  # over the height
    amplitude: Float32[Tensor, "V J 3"]  # root mean square over the height
    spread: Float32[Tensor, "J 3"]  # spread of sizes about the amplitude
    leaf_share: Float32[Tensor, "V J 1"]  # share of the motion that is the leaf's own
    leaves: Leaves
    lifts: tuple[SparseRows, SparseRows]  # [C, W] from nodes to cells half as large, [V, C] to voxels
    leaf_lift: SparseRows  # [V, C]; voxels of a leaf get the value at its base
    network: SmallNetwork
    axes: Float32[np.ndarray, "3 3"]  # rows are downwind, crosswind, up
    height_m: float
    foliage: float | None  # 0 is bare, 1 in leaf; None if unknown
    finer: csr_array | None  # interpolation to the requested grid, if that is finer than the network's

    def assemble(
        self, whitened: Float32[Tensor, "W J 6"], white: Float32[Tensor, "L J 6"]
    ) -> Complex64[Tensor, "V K 3"]:
        """Combine lean and sway by the network's formula, leaves swinging: over the height, in the wind's frame."""
        for lift in self.lifts:
            whitened = lift.apply(whitened)
        nodes = to_unit_power(unpack_channels(whitened))
        leaf = to_unit_power(unpack_channels(self.leaf_lift.apply(white)))
        field = (1 - self.leaf_share).sqrt() * nodes + self.leaf_share.sqrt() * leaf
        moving = with_spread(field, self.spread) * self.amplitude
        return self.leaves.swing(torch.cat([self.lean[:, None].to(moving.dtype), moving], dim=1))

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
    with ThreadPoolExecutor(1) as pool:  # runs in parallel to the foliage network, which has one core
        noise = pool.submit(noise_basis, nodes.grids, nodes.links)
        lift = pool.submit(upsample_matrix, tree.grids, top - 1, 0)
        foliage_values = network.foliage(tree)
    from_cells = lift.result()
    lean, log_amplitude = network.amplitude.of_tree(tree, foliage_values, air)
    spread = at_speed(network.spread, air[0, 0])
    rms = above_floor(log_amplitude, air[:, :NUM_WIND]) * at_speed(network.log_gain, air[0, 0]).exp()
    free = 1 - (-(tree.scalars[:, ROOT_DISTANCE] / fixed_share).square()).exp()  # [V]
    leaves = leaves_of(coarse.grid, foliage_values, free, axes)
    return PreparedTree(
        voxels=coarse,
        nodes=nodes,
        wind=air,
        noise=noise.result(),
        neighbourhood=neighbourhood(nodes),
        node_log_amplitude=pool_to(log_amplitude, tree.grids, top),
        lean=sparse_rows(neighbour_means(tree.grids.levels[0])).apply(lean) * free[:, None],
        amplitude=rms * free[:, None, None],
        spread=spread,
        leaf_share=foliage_values[:, :1].clamp(0, 1).square()[:, None] * network.leaf_share[:, None],
        leaves=leaves,
        lifts=(sparse_rows(upsample_matrix(tree.grids, top, top - 1)), sparse_rows(from_cells)),
        leaf_lift=sparse_rows(csr_array(unit_rows(from_cells)[leaves.base.numpy()])),
        network=network,
        axes=axes,
        height_m=height_m,
        foliage=None if coarse.moments is None else foliage_of(foliage_values),
        finer=finer,
    )
