"""GroupNorm per sample, over all of its voxels."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamictree.sparse.level import SparseLevel


class SampleGroupNorm(nn.Module):
    """`torch.nn.GroupNorm` per sample; axes between rows and channels are normalised separately."""

    def __init__(self, num_groups: int, channels: int, *, eps: float = 1e-5) -> None:
        super().__init__()
        assert channels % num_groups == 0, f"{channels} channels do not divide into {num_groups} groups"
        self.num_groups, self.eps = num_groups, eps
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(
        self,
        features: Float[Tensor, "V *inner C"],
        level: SparseLevel,
        scale: Float[Tensor, "B *inner C"] | None = None,
        shift: Float[Tensor, "B *inner C"] | None = None,
    ) -> Float[Tensor, "V *inner C"]:
        """Normalise; with `scale` and `shift` per sample, also multiply by 1 + scale and add shift."""
        normalised = []
        for index, rows in enumerate(level.sample_slices):
            sample = features[rows]
            variance, mean = torch.var_mean(sample, dim=0, correction=0)  # [*inner, C]
            variance, mean = self._over_groups(variance, mean)
            gain = self.weight * torch.rsqrt(variance + self.eps)
            offset = self.bias - mean * gain
            if scale is not None and shift is not None:
                gain, offset = gain * (1 + scale[index]), offset * (1 + scale[index]) + shift[index]
            normalised.append(torch.addcmul(offset, sample, gain))
        return torch.cat(normalised) if len(normalised) > 1 else normalised[0]

    def _over_groups(self, variance: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
        shape = mean.shape
        grouped = (*shape[:-1], self.num_groups, shape[-1] // self.num_groups)
        channel_mean = mean.view(grouped)
        group_mean = channel_mean.mean(dim=-1, keepdim=True)
        # law of total variance: within the channels, and between their means
        spread = (variance.view(grouped) + (channel_mean - group_mean).square()).mean(dim=-1, keepdim=True)
        return spread.expand(grouped).reshape(shape), group_mean.expand(grouped).reshape(shape)
