"""Body of the small denoiser: layers that mix each node with means over its neighbourhood at several scales.

A tree has few nodes, and its motion has no preferred grid direction, as vectors are in the wind's frame. So instead of
27 taps, a layer reads fixed means (the node itself, touching nodes, its ancestors one and two levels up, the whole
tree), each with its own linear map. It costs a third of the U-Net, and every layer reads the whole tree.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy.sparse import csr_array, eye_array, vstack
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.models.small.features import TreeFeatures
from dynamictree.sparse.matrices import (
    SparseRows,
    link_matrices,
    neighbour_means,
    pool_matrix,
    sparse_rows,
    upsample_matrix,
)

NUM_NEAR = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Neighbourhood:
    """Operators of the neighbourhood means that a layer reads, of one tree or of a batch."""

    near: SparseRows  # [4 W, W]: per node itself, and means over touching, bearing and borne nodes
    pools: tuple[SparseRows, ...]  # [coarser, W]: mean over the nodes of an ancestor; the last is the whole tree
    raises: tuple[SparseRows, ...]  # [finer, coarser]: from each pool to the one before, the first to the nodes


def neighbourhood(nodes: TreeFeatures) -> Neighbourhood:
    """Build the operators of one tree, given at its nodes (see `coarsen_features`)."""
    grids, size = nodes.grids, len(nodes.scalars)
    pools = [pool_matrix(grids, depth, 0) for depth in (1, 2)]
    raises = [upsample_matrix(grids, depth, depth - 1, steps=1) for depth in (1, 2)]
    pools.append(csr_array(np.full((1, size), 1 / size, np.float32)))
    raises.append(csr_array(np.ones((len(grids.levels[2]), 1), np.float32)))
    own = eye_array(size, dtype=np.float32)
    near = vstack([own, neighbour_means(grids.levels[0]), *link_matrices(nodes.links, size)], format="csr")
    node_by_node = np.arange(NUM_NEAR * size).reshape(NUM_NEAR, size).T.ravel()
    return Neighbourhood(
        near=sparse_rows(csr_array(near[node_by_node])),
        pools=tuple(sparse_rows(matrix) for matrix in pools),
        raises=tuple(sparse_rows(matrix) for matrix in raises),
    )


def batch_neighbourhoods(trees: Sequence[Neighbourhood]) -> Neighbourhood:
    """Combine several trees' operators block-diagonally."""
    return Neighbourhood(
        near=_block([tree.near for tree in trees]),
        pools=tuple(_block(same) for same in zip(*(tree.pools for tree in trees), strict=True)),
        raises=tuple(_block(same) for same in zip(*(tree.raises for tree in trees), strict=True)),
    )


class MixerBlock(nn.Module):
    """Norm with scale and shift, seven means through a hidden layer, zero-initialised, residual."""

    def __init__(self, width: int, embedding: int, *, num_far: int = 3) -> None:
        super().__init__()
        self.modulate = nn.Linear(embedding, 2 * width)
        self.near = nn.Linear(NUM_NEAR * width, 2 * width)
        self.far = nn.ModuleList(nn.Linear(width, 2 * width, bias=False) for _ in range(num_far))
        self.out = nn.Linear(2 * width, width)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        nn.init.zeros_(self.modulate.weight)
        nn.init.zeros_(self.modulate.bias)

    def forward(
        self,
        features: Float[Tensor, "W J C"],
        around: Neighbourhood,
        embedding: Float[Tensor, "B J E"],
        tree_of_node: Int64[Tensor, " W"],
    ) -> Float[Tensor, "W J C"]:
        """Apply one layer; `embedding` is of each tree's wind, noise level and frequencies."""
        modulation = self.modulate(embedding)  # [B, J, 2 C]
        at_node = modulation if len(modulation) == 1 else modulation[tree_of_node]
        scale, shift = at_node.chunk(2, dim=-1)
        normal = torch.addcmul(shift, functional.layer_norm(features, features.shape[-1:]), 1 + scale)
        near = around.near.apply(normal).view(len(normal), NUM_NEAR, *normal.shape[1:])
        hidden = self.near(near.transpose(1, 2).flatten(2))
        raised: Tensor | float = 0.0
        for linear, pool, back in reversed(list(zip(self.far, around.pools, around.raises, strict=True))):
            raised = back.apply(linear(pool.apply(normal)) + raised)
        hidden += raised
        residual: Tensor = self.out(functional.silu(hidden))
        return features + residual


def _block(matrices: Sequence[SparseRows]) -> SparseRows:
    columns = np.cumsum([0, *(matrix.num_columns for matrix in matrices)]).tolist()
    entries = np.cumsum([0, *(len(matrix.columns) for matrix in matrices)]).tolist()
    return SparseRows(
        columns=torch.cat([matrix.columns + start for matrix, start in zip(matrices, columns, strict=False)]),
        starts=torch.cat([matrix.starts + start for matrix, start in zip(matrices, entries, strict=False)]),
        weights=torch.cat([matrix.weights for matrix in matrices]),
        num_columns=columns[-1],
    )
