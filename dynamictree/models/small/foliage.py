"""Foliage network: predicts for each voxel leaf or wood, the position on its leaf, and the leaf's own motion.

A leaf swings fast about its base; wood does not. The base of a voxel's leaf follows from the shape around it, so this
is the only part of the small model with convolutions: three levels, few channels. It is trained by itself, on leaves
and stems that the dataset records; its output is an input of the amplitude network.
"""

import torch
from jaxtyping import Float32
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.models.small.features import NUM_SCALARS, TreeFeatures
from dynamictree.models.small.surface_shape import NUM_SURFACE, NUM_TENSORS
from dynamictree.sparse.conv import SubmanifoldConv
from dynamictree.sparse.level import Pyramid, SparseLevel
from dynamictree.sparse.pool import average_pool, upsample

STEM_AXIS, NORMAL = 1, 3  # indices into `TreeFeatures.vectors`
NUM_INPUTS = NUM_SCALARS + 6 + 6 + 2 + NUM_SURFACE + 6 * NUM_TENSORS
NUM_PARTS = 10
"""Leaf share; distance from the leaf's base, the same over the leaf's length, ln length, all times leaf share; stem
level; ln length and ln radius of the stem [m]; vector from the leaf's base in the grid's frame. Distances are over the
height, times ARM_SCALE."""
STEM, ARM = slice(4, 7), slice(7, 10)
ARM_SCALE = 30.0  # leaves are a 30th of the height
NUM_MOVING = 15
NUM_FOLIAGE_VALUES = NUM_PARTS + NUM_MOVING
CLIP = 5.0  # standard deviations
SYMMETRIC = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # indices of the six entries of a symmetric tensor


class ResConv(nn.Module):
    """LayerNorm, 3³ convolution, SiLU, linear, added."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.conv = SubmanifoldConv(width, width)
        self.out = nn.Linear(width, width)

    def forward(self, features: Float32[Tensor, "V C"], level: SparseLevel) -> Float32[Tensor, "V C"]:
        """Apply the block on one level."""
        hidden: Tensor = self.out(functional.silu(self.conv(self.norm(features), level)))
        return features + hidden.float()


class FoliageNetwork(nn.Module):
    """A small U-Net over 128³, 64³ and 32³ of a 128³ tree."""

    mean: Tensor  # [F], mean of the inputs
    deviation: Tensor
    told_mean: Tensor  # [O], mean of the targets
    told_deviation: Tensor

    def __init__(self, *, widths: tuple[int, int, int] = (24, 48, 64)) -> None:
        super().__init__()
        fine, middle, coarse = widths
        self.enter = nn.Linear(NUM_INPUTS, fine)
        self.down = nn.ModuleList([ResConv(fine), ResConv(fine), ResConv(middle), ResConv(coarse)])
        self.up = nn.ModuleList([ResConv(coarse), ResConv(middle), ResConv(fine)])
        self.widen = nn.ModuleList([nn.Linear(fine, middle), nn.Linear(middle, coarse)])
        self.narrow = nn.ModuleList([nn.Linear(coarse, middle), nn.Linear(middle, fine)])
        self.head = nn.Sequential(
            nn.LayerNorm(fine), nn.Linear(fine, 4 * fine), nn.SiLU(), nn.Linear(4 * fine, NUM_FOLIAGE_VALUES)
        )
        self.register_buffer("mean", torch.zeros(NUM_INPUTS))
        self.register_buffer("deviation", torch.ones(NUM_INPUTS))
        self.register_buffer("told_mean", torch.zeros(NUM_FOLIAGE_VALUES))
        self.register_buffer("told_deviation", torch.ones(NUM_FOLIAGE_VALUES))

    def forward(self, tree: TreeFeatures) -> Float32[Tensor, "V O"]:
        """Predict NUM_PARTS values, then ln of the size at k = 1 … 15 over the height, at drag and gust 1."""
        standard = self.standard(tree)
        foliage_values: Tensor = standard * self.told_deviation + self.told_mean
        return foliage_values

    def standard(self, tree: TreeFeatures) -> Float32[Tensor, "V O"]:
        """Predict the same values, with mean 0 and deviation 1 over the training set."""
        grids: Pyramid = tree.grids
        levels = grids.levels
        fine = self.enter(((foliage_inputs(tree) - self.mean) / self.deviation).clamp(-CLIP, CLIP)).float()
        fine = self.down[1](self.down[0](fine, levels[0]), levels[0])
        middle = self.widen[0](average_pool(fine, grids.parents[0], len(levels[1]))).float()
        middle = self.down[2](middle, levels[1])
        coarse = self.widen[1](average_pool(middle, grids.parents[1], len(levels[2]))).float()
        coarse = self.up[0](self.down[3](coarse, levels[2]), levels[2])
        middle = self.up[1](middle + upsample(self.narrow[0](coarse).float(), grids.parents[1]), levels[1])
        fine = self.up[2](fine + upsample(self.narrow[1](middle).float(), grids.parents[0]), levels[0])
        foliage_values: Tensor = self.head(fine).float()
        return foliage_values


def foliage_inputs(tree: TreeFeatures) -> Float32[Tensor, "V F"]:
    """Return the inputs: scalars of the tree and of its surface, and functions of normals and stem axes that do not
    depend on their sign, which is arbitrary.
    """
    axis, normal = tree.vectors[:, STEM_AXIS], tree.vectors[:, NORMAL]
    together = (axis * normal).sum(dim=1, keepdim=True).square()
    upper = tree.tensors[..., *SYMMETRIC].flatten(1)  # [V, 6 R]
    own = [tree.scalars, _second_moments(normal), _second_moments(axis), together, axis[:, 2:], tree.surface, upper]
    return torch.cat(own, dim=1)


def _second_moments(vectors: Float32[Tensor, "V 3"]) -> Float32[Tensor, "V 6"]:
    return torch.cat([vectors.square(), vectors * vectors.roll(1, dims=1)], dim=1)
