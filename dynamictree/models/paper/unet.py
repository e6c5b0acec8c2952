"""Sparse U-Net over the levels of a given pyramid; upsampling restores exactly the pooled voxels."""

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.sparse.attention import SampleAttention
from dynamictree.sparse.conv import SubmanifoldConv
from dynamictree.sparse.level import Pyramid, SparseLevel
from dynamictree.sparse.norm import SampleGroupNorm
from dynamictree.sparse.pool import average_pool, upsample


@dataclass(frozen=True, kw_only=True, eq=False)
class Resample:
    """Resample features to the next coarser level (mean of the children) or the next finer one (nearest)."""

    before: SparseLevel
    after: SparseLevel
    parents: Int64[Tensor, " _"]  # row in the coarser level of each row of the finer one
    coarser: bool  # `after` is the coarser of the two

    def apply(self, features: Float[Tensor, "V ..."]) -> Float[Tensor, "W ..."]:
        """Return the features on the level `after`."""
        if self.coarser:
            return average_pool(features, self.parents, len(self.after))
        return upsample(features, self.parents)


class ResBlock(nn.Module):
    """GN, SiLU, conv; GN with scale and shift from the embedding, SiLU, zero-initialised conv; skip."""

    def __init__(self, in_channels: int, out_channels: int, embedding: int, *, num_groups: int = 32) -> None:
        super().__init__()
        self.norm_in = SampleGroupNorm(math.gcd(num_groups, in_channels), in_channels)
        self.conv_in = SubmanifoldConv(in_channels, out_channels)
        self.modulate = nn.Linear(embedding, 2 * out_channels)
        self.norm_out = SampleGroupNorm(math.gcd(num_groups, out_channels), out_channels)
        self.conv_out = SubmanifoldConv(out_channels, out_channels)
        nn.init.zeros_(self.conv_out.weight)
        self.skip = nn.Identity() if in_channels == out_channels else nn.Linear(in_channels, out_channels)

    def forward(
        self,
        features: Float[Tensor, "V *inner C"],
        level: SparseLevel,
        embedding: Float[Tensor, "B *inner E"],
        resample: Resample | None = None,
    ) -> Float[Tensor, "W *inner D"]:
        """Apply the block on `level`; with `resample`, the features come from the level before and are resampled."""
        before = level if resample is None else resample.before
        activated = functional.silu(self.norm_in(features, before))
        if resample is not None:
            activated, features = resample.apply(activated), resample.apply(features)
        hidden = self.conv_in(activated, level)
        scale, shift = self.modulate(functional.silu(embedding)).chunk(2, dim=-1)
        hidden = functional.silu(self.norm_out(hidden, level, scale, shift))
        residual: Tensor = self.conv_out(hidden, level) + self.skip(features)
        return residual


@dataclass(frozen=True, kw_only=True)
class UNetShape:
    """Widths and depths. The defaults are the paper's (appendix B): 128 channels, depth 2, [1, 2, 4, 4], 8 heads."""

    base: int = 128
    multipliers: tuple[int, ...] = (1, 2, 4, 4)
    num_blocks: int = 2  # residual blocks per level on the way down
    num_skips: int = 3  # blocks per level on the way up, each with one of the level's outputs concatenated
    attention_levels: tuple[int, ...] = (2, 3)  # downsampling by 4 and 8
    num_heads: int = 8
    num_groups: int = 32
    embedding: int = 512

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of each level."""
        return tuple(self.base * multiplier for multiplier in self.multipliers)


class Stage(nn.Module):
    """A residual block, followed by attention where the level has it."""

    def __init__(self, in_channels: int, out_channels: int, shape: UNetShape, *, attention: bool) -> None:
        super().__init__()
        self.block = ResBlock(in_channels, out_channels, shape.embedding, num_groups=shape.num_groups)
        self.attention = (
            SampleAttention(out_channels, num_heads=shape.num_heads, num_groups=shape.num_groups) if attention else None
        )

    def forward(
        self, features: Float[Tensor, "V *inner C"], level: SparseLevel, embedding: Float[Tensor, "B *inner E"]
    ) -> Float[Tensor, "V *inner D"]:
        """Apply the block, and attention if there is one, on one level."""
        hidden: Tensor = self.block(features, level, embedding)
        return hidden if self.attention is None else self.attention(hidden, level)


class SparseUNet(nn.Module):
    """Stem, down, middle, up with skips, zero-initialised head. As in XCube, with the shape's number of skips."""

    def __init__(self, in_channels: int, out_channels: int, shape: UNetShape) -> None:
        super().__init__()
        self.shape = shape
        widths = shape.widths
        self.stem = SubmanifoldConv(in_channels, widths[0])
        self.down, self.pool = nn.ModuleList(), nn.ModuleList()
        self.up, self.unpool = nn.ModuleList(), nn.ModuleList()
        for depth, width in enumerate(widths):
            attention = depth in shape.attention_levels
            self.down.append(
                nn.ModuleList(Stage(width, width, shape, attention=attention) for _ in range(shape.num_blocks))
            )
            self.up.append(
                nn.ModuleList(Stage(2 * width, width, shape, attention=attention) for _ in range(shape.num_skips))
            )
        for width, below in pairwise(widths):
            self.pool.append(ResBlock(width, below, shape.embedding, num_groups=shape.num_groups))
            self.unpool.append(ResBlock(below, width, shape.embedding, num_groups=shape.num_groups))
        self.middle = nn.ModuleList(
            Stage(widths[-1], widths[-1], shape, attention=attend) for attend in (bool(shape.attention_levels), False)
        )
        self.norm = SampleGroupNorm(min(shape.num_groups, widths[0]), widths[0])
        self.head = SubmanifoldConv(widths[0], out_channels)
        nn.init.zeros_(self.head.weight)

    def forward(
        self,
        features: Float[Tensor, "V *inner C"],
        grids: Pyramid,
        embedding: Float[Tensor, "B *inner E"],
        *,
        top: int = 0,
    ) -> Float[Tensor, "V *inner D"]:
        """Map features on the level `top` of the pyramid to new ones on the same level."""
        levels = grids.levels[top : top + len(self.down)]
        hidden = self.stem(features, levels[0])
        skips: list[list[Tensor]] = []
        for depth, stages in enumerate(_stages(self.down)):
            if depth:
                resample = _resample(grids, top + depth - 1, top + depth)
                hidden = self.pool[depth - 1](hidden, levels[depth], embedding, resample=resample)
            skips.append([hidden])
            for stage in stages:
                hidden = stage(hidden, levels[depth], embedding)
                skips[-1].append(hidden)
        for stage in self.middle:
            hidden = stage(hidden, levels[-1], embedding)
        for depth in reversed(range(len(levels))):
            for stage, skip in zip(_stages(self.up)[depth], reversed(skips[depth]), strict=False):
                hidden = stage(torch.cat([hidden, skip], dim=-1), levels[depth], embedding)
            if depth:
                resample = _resample(grids, top + depth, top + depth - 1)
                hidden = self.unpool[depth - 1](hidden, levels[depth - 1], embedding, resample=resample)
        head: Tensor = self.head(functional.silu(self.norm(hidden, levels[0])), levels[0])
        return head


def _stages(levels: nn.ModuleList) -> list[nn.ModuleList]:
    return [stages for stages in levels if isinstance(stages, nn.ModuleList)]


def _resample(grids: Pyramid, start: int, end: int) -> Resample:
    return Resample(
        before=grids.levels[start], after=grids.levels[end], parents=grids.parents[min(start, end)], coarser=end > start
    )
