"""Full self-attention over all voxels of one sample."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.sparse.level import SparseLevel
from dynamictree.sparse.norm import SampleGroupNorm


class SampleAttention(nn.Module):
    """Norm, queries and keys and values, zero-initialised projection, residual. No positional encoding, as in XCube."""

    def __init__(self, channels: int, *, num_heads: int, num_groups: int = 32) -> None:
        super().__init__()
        assert channels % num_heads == 0, f"{channels} channels do not divide into {num_heads} heads"
        self.num_heads = num_heads
        self.norm = SampleGroupNorm(num_groups, channels)
        self.queries_keys_values = nn.Linear(channels, 3 * channels)
        self.project = nn.Linear(channels, channels)
        nn.init.zeros_(self.project.weight)
        nn.init.zeros_(self.project.bias)

    def forward(self, features: Float[Tensor, "V *inner C"], level: SparseLevel) -> Float[Tensor, "V *inner C"]:
        """Attend between the voxels of each sample; axes between rows and channels are independent."""
        stacked = self.queries_keys_values(self.norm(features, level))
        attended = [self._attend(stacked[rows]) for rows in level.sample_slices]
        projected: Tensor = self.project(torch.cat(attended))
        return features + projected

    def _attend(self, stacked: Float[Tensor, "V *inner C3"]) -> Float[Tensor, "V *inner C"]:
        num_voxels, inner = len(stacked), stacked.shape[1:-1]
        width = stacked.shape[-1] // 3 // self.num_heads
        heads = stacked.reshape(num_voxels, -1, 3, self.num_heads, width)
        queries, keys, values = heads.permute(2, 1, 3, 0, 4)  # each [inner, heads, V, width]
        mixed = functional.scaled_dot_product_attention(queries, keys, values)
        return mixed.permute(2, 0, 1, 3).reshape(num_voxels, *inner, -1)
