"""Building blocks of the encoder and the U-Net. After XCube's sparse U-Net, see docs/decisions."""

import math
from dataclasses import dataclass

from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.sparse.conv import SubmanifoldConv
from dynamictree.sparse.level import SparseLevel
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
