"""One tree in one wind, ready for chance: what amplitude network and geometry say, and how nodes become voxels."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex64, Float32
from scipy.sparse import csr_array
from torch import Tensor

from dynamictree.diffusion.channels import unpack_channels
from dynamictree.models.small.amplitude import moving
from dynamictree.models.small.correlated_noise import NoiseBasis, noise_basis
from dynamictree.models.small.features import (
    ROOT_DISTANCE,
    TreeCondition,
    coarsen_condition,
    tree_condition,
    wind_vector,
)
from dynamictree.models.small.leaf_swing import Leaves, leaves_of
from dynamictree.models.small.mixer import Neighbourhood, neighbourhood
from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.small.node_operators import SparseRows, raise_matrix, sparse_rows, touching, unit_rows
from dynamictree.sparse.level import pyramid
from dynamictree.sparse.pool import pool_to
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.moments import coarse_moments
from dynamictree.voxel.voxelize import SurfaceVoxels

SOFTNESS = 0.1
"""ε of `soften`: 0 is phase alone, large is the field as it was drawn. Chosen on validation trees (docs/decisions)."""


HELD = 0.02
"""Of the height: so near to the roots, along the tree, the ground holds the stem, whatever the network guesses."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedTree:
    """Everything about a tree that the sampler and what follows it need."""

    nodes: TreeCondition
    wind: Float32[Tensor, "1 4"]
    noise: NoiseBasis
    around: Neighbourhood
    node_log_amplitude: Float32[Tensor, "W J 3"]
    lean: Float32[Tensor, "V 3"]  # over the height
    amplitude: Float32[Tensor, "V J 3"]  # g A over the height
    leaves: Leaves
    lift: SparseRows  # [V, W]
    local: SparseRows  # [V, L], rows of unit length: noise finer than a node
    node_scale: Float32[Tensor, "J 3"]
    residual_share: Float32[Tensor, "J 3"]
    axes: Float32[np.ndarray, "3 3"]  # rows are downwind, crosswind, up
    height_m: float
    finer: csr_array | None  # from the network's grid to the asked one, where that is finer

    def assemble(self, whitened: Float32[Tensor, "W J 6"], generator: torch.Generator) -> Complex64[Tensor, "V K 3"]:
        """Lean, and g A · soften(lift(s u) + ρ n), leaves swinging: over the height, in the wind's frame."""
        white = torch.randn(self.local.num_columns, *whitened.shape[1:], generator=generator) / math.sqrt(2)
        scaled = whitened * self.node_scale.repeat(1, 2)
        field = self.lift.apply(scaled) + self.local.apply(white * self.residual_share.sqrt().repeat(1, 2))
        return self.moved(soften(unpack_channels(field)))

    def moved(self, field: Complex64[Tensor, "V J 3"]) -> Complex64[Tensor, "V K 3"]:
        """Lean, and g A · field, leaves swinging about their bases."""
        return self.leaves.swing(torch.cat([self.lean[:, None].to(field.dtype), field * self.amplitude], dim=1))

    def to_metres(self, relative: Complex64[Tensor, "V K 3"]) -> Complex64[np.ndarray, "X K 3"]:
        """In the tree's own frame, on the grid that was asked for [m]."""
        coefficients = relative.numpy() @ self.axes * self.height_m
        if self.finer is not None:
            raised = self.finer @ coefficients.reshape(len(coefficients), -1)
            coefficients = raised.reshape(-1, *coefficients.shape[1:])
        return np.ascontiguousarray(coefficients.astype(np.complex64))


def soften(field: Complex64[Tensor, "V J 3"]) -> Complex64[Tensor, "V J 3"]:
    """Bring the size of each number near 1 and leave its phase: size r becomes r √((1 + ε²) / (r² + ε²)).

    For given shape and wind the size is A, chance has the phase; where the phase turns quickly, size stays small, so
    that the field remains smooth.
    """
    power = field.real.square() + field.imag.square()
    return field * torch.sqrt((1 + SOFTNESS**2) / (power + SOFTNESS**2))


def prepare_tree(network: SmallNetwork, voxels: SurfaceVoxels, wind: Wind) -> PreparedTree:
    """Measure the tree, ask the amplitude network, make the matrices."""
    coarse, finer = at_resolution(voxels, network.preset.resolution)
    tree, air, top = tree_condition(coarse), wind_vector([wind]), network.preset.top
    height_m, axes = float(tree.height_m[0]), wind_axes(wind)
    told = network.foliage(tree)
    lean, log_amplitude = network.amplitude.of_tree(tree, told, air)
    nodes = coarsen_condition(tree, top)
    free = 1 - (-(tree.scalars[:, ROOT_DISTANCE] / HELD).square()).exp()  # [V]
    smooth = sparse_rows(touching(tree.grids.levels[0]))
    return PreparedTree(
        nodes=nodes,
        wind=air,
        noise=noise_basis(nodes),
        around=neighbourhood(nodes),
        node_log_amplitude=pool_to(log_amplitude, tree.grids, top),
        lean=smooth.apply(lean) * free[:, None],
        amplitude=moving(log_amplitude) * network.energy_gain * free[:, None, None],
        leaves=leaves_of(coarse.grid, told, free, height_m=height_m, axes=axes),
        lift=sparse_rows(raise_matrix(tree.grids, top, 0)),
        local=sparse_rows(unit_rows(raise_matrix(tree.grids, top - 1, 0))),
        node_scale=network.node_scale,
        residual_share=network.residual_share,
        axes=axes,
        height_m=height_m,
        finer=finer,
    )


def wind_axes(wind: Wind) -> Float32[np.ndarray, "3 3"]:
    """Rows are downwind, crosswind and up."""
    angle = math.radians(wind.direction_deg)
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], np.float32)


def at_resolution(voxels: SurfaceVoxels, resolution: int) -> tuple[SurfaceVoxels, csr_array | None]:
    """The same tree on a coarser grid, and the matrix that raises values from it; None where it is that grid."""
    grid = voxels.grid
    factor = grid.resolution // resolution
    if factor == 1:
        return voxels, None
    coarse = VoxelGrid.from_coords(
        grid.coords // factor,
        origin_m=grid.origin_m,
        voxel_size_m=grid.voxel_size_m * factor,
        resolution=resolution,
    )
    owner = coarse.rows_of(grid.coords // factor)
    normals = np.zeros((len(coarse), 3), np.float32)
    np.add.at(normals, owner, voxels.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
    depth = int(math.log2(factor))
    moments = None if voxels.moments is None else coarse_moments(voxels.moments, grid, coarse, owner)
    # a pyramid's coarser rows are in ascending order of coordinates, as the coarse grid's are
    fine = pyramid(torch.from_numpy(grid.coords.astype(np.int64)), depth + 1)
    return SurfaceVoxels(grid=coarse, normals=normals, moments=moments), raise_matrix(fine, depth, 0)
