"""The paper's condition: a fine voxel grid (512³) as features on the grid of the spectrum (128³). Paper section 3.4.

Blocks after XCube's sparse encoder: [GroupNorm(8), 3³ convolution without bias, ReLU] twice, max-pooling before every
block but the first. The paper gives base 32, depth 3 and width 128 at the end.
"""

import math

import torch
from jaxtyping import Float, Float32
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.sparse.conv import SubmanifoldConv
from dynamictree.sparse.level import Pyramid, SparseLevel
from dynamictree.sparse.norm import SampleGroupNorm
from dynamictree.sparse.pool import max_pool

NUM_OCTAVES = 5
POSITION_FEATURES = 3 * (1 + 2 * NUM_OCTAVES)  # 33


class SparseEncoder(nn.Module):
    """Encode the finest level of a pyramid to its level `len(widths) - 1`."""

    def __init__(self, *, base: int = 32, widths: tuple[int, ...] = (32, 64, 128), num_groups: int = 8) -> None:
        normal_features = 3
        super().__init__()
        self.enter = nn.Linear(POSITION_FEATURES + normal_features, base)
        before = (base, *widths[:-1])
        self.blocks = nn.ModuleList(
            EncoderBlock(left, right, num_groups) for left, right in zip(before, widths, strict=True)
        )

    def forward(
        self, positions: Float32[Tensor, "X 3"], normals: Float32[Tensor, "X 3"], grids: Pyramid
    ) -> Float[Tensor, "V D"]:
        """Return the latent condition g, a row per coarsest voxel; positions are in [-1, 1] of the cube."""
        features: Tensor = self.enter(torch.cat([fourier_features(positions), normals], dim=1))
        for depth, block in enumerate(self.blocks):
            if depth:
                features = max_pool(features, grids.parents[depth - 1], len(grids.levels[depth]))
            features = block(features, grids.levels[depth])
        return features


class EncoderBlock(nn.Module):
    """Norm, convolution, ReLU, twice."""

    def __init__(self, in_channels: int, out_channels: int, num_groups: int) -> None:
        super().__init__()
        self.norms = nn.ModuleList(SampleGroupNorm(num_groups, width) for width in (in_channels, out_channels))
        self.convs = nn.ModuleList(
            SubmanifoldConv(width, out_channels, bias=False) for width in (in_channels, out_channels)
        )

    def forward(self, features: Float[Tensor, "V C"], level: SparseLevel) -> Float[Tensor, "V D"]:
        """Apply the block on one level."""
        for norm, conv in zip(self.norms, self.convs, strict=True):
            convolved: Tensor = conv(norm(features, level), level)
            features = functional.relu(convolved)
        return features


def fourier_features(positions: Float32[Tensor, "X 3"]) -> Float32[Tensor, "X 33"]:
    """Positions with the sines and cosines of five octaves."""
    angles = positions[:, None] * (math.pi * 2.0 ** torch.arange(NUM_OCTAVES, device=positions.device))[:, None]
    return torch.cat([positions, angles.sin().flatten(1), angles.cos().flatten(1)], dim=1)
