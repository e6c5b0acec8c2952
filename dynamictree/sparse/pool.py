"""Pooling and upsampling between a level and the next coarser one, on existing grids only."""

import torch
from jaxtyping import Inexact, Int64
from torch import Tensor

from dynamictree.sparse.level import Pyramid


def average_pool(
    features: Inexact[Tensor, "V ..."], parents: Int64[Tensor, " V"], num_coarse: int
) -> Inexact[Tensor, "W ..."]:
    """Return the mean over the occupied children of each coarse voxel."""
    children = torch.bincount(parents, minlength=num_coarse).to(features.dtype)
    total = features.new_zeros(num_coarse, *features.shape[1:]).index_add(0, parents, features)
    return total / children.view(-1, *[1] * (features.dim() - 1))


def pool_to(features: Inexact[Tensor, "V ..."], grids: Pyramid, top: int) -> Inexact[Tensor, "W ..."]:
    """Apply `average_pool` from the finest level up to level `top`."""
    for parents, level in zip(grids.parents[:top], grids.levels[1:], strict=False):
        features = average_pool(features, parents, len(level))
    return features


def max_pool(features: Inexact[Tensor, "V C"], parents: Int64[Tensor, " V"], num_coarse: int) -> Inexact[Tensor, "W C"]:
    """Return the largest value among the occupied children of each coarse voxel."""
    lowest = features.new_full((num_coarse, features.shape[1]), -torch.inf)
    return lowest.scatter_reduce(0, parents[:, None].expand_as(features), features, "amax")


def upsample(features: Inexact[Tensor, "W ..."], parents: Int64[Tensor, " V"]) -> Inexact[Tensor, "V ..."]:
    """Copy to each voxel the features of its parent (nearest)."""
    return features.index_select(0, parents)
