"""The small preset's denoiser: one frequency at a time, all frequencies in one pass, preconditioned as in EDM.

Karras et al. 2022, arXiv 2206.00364: D(x; σ) = c_skip x + c_out F(c_in x; ln σ), with σ_data = 1 because the
whitened spectrum has unit variance.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float32, Int64
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.diffusion.channels import CHANNELS
from dynamictree.diffusion.embedding import sinusoid
from dynamictree.models.small.features import NUM_FEATURES, NUM_WIND, TreeCondition, node_features
from dynamictree.models.small.mixer import MixerBlock, Neighbourhood

TYPICAL = -8.0  # of ln A over the height
NOISE_FEATURES = 64
NOISE_SCALE = 25.0
"""ln σ runs over ± 4; times this, the sinusoids' periods cover it from coarse to fine."""


@dataclass(frozen=True, kw_only=True)
class DenoiserShape:
    """Widths and depth."""

    width: int = 64
    embedding: int = 96
    num_blocks: int = 6


class Denoiser(nn.Module):
    """F and its preconditioning. Frequencies are an axis between nodes and channels and do not see one another."""

    def __init__(self, *, num_frequencies: int, shape: DenoiserShape) -> None:
        super().__init__()
        self.describe = nn.Sequential(
            nn.Linear(NUM_FEATURES - 2, 2 * shape.width), nn.SiLU(), nn.Linear(2 * shape.width, shape.width)
        )
        self.describe_wind = nn.Linear(NUM_WIND + 1, shape.embedding)
        self.join = nn.Linear(CHANNELS + 3, shape.width)
        self.embed_noise = nn.Linear(NOISE_FEATURES, shape.embedding)
        self.embed_frequency = nn.Embedding(num_frequencies, shape.embedding)
        self.mix = nn.Sequential(nn.SiLU(), nn.Linear(shape.embedding, shape.embedding), nn.SiLU())
        self.blocks = nn.ModuleList(MixerBlock(shape.width, shape.embedding) for _ in range(shape.num_blocks))
        self.head = nn.Linear(shape.width, CHANNELS)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def condition(
        self, nodes: TreeCondition, wind: Float32[Tensor, "B 4"]
    ) -> tuple[Float32[Tensor, "W C"], Float32[Tensor, "B E"]]:
        """What does not change from step to step: features of the nodes (see `coarsen_condition`), and of the wind."""
        air = torch.cat([wind[:, :NUM_WIND], nodes.height_m.log()[:, None]], dim=1)
        return self.describe(node_features(nodes, wind)[:, :-2]).float(), self.describe_wind(air).float()

    def forward(
        self,
        noisy: Float32[Tensor, "W J 6"],
        sigma: Float32[Tensor, "B J"],
        frequency: Int64[Tensor, "B J"],
        log_amplitude: Float32[Tensor, "W J 3"],
        condition: tuple[Float32[Tensor, "W C"], Float32[Tensor, "B E"]],
        around: Neighbourhood,
        sample: Int64[Tensor, " W"],
    ) -> Float32[Tensor, "W J 6"]:
        """D(x; σ): the expected whitened spectrum. `sample`: the tree that each node belongs to."""
        geometry, air = condition
        noise_features = sinusoid(NOISE_SCALE * sigma.log(), NOISE_FEATURES)
        embedding = self.mix(self.embed_noise(noise_features) + self.embed_frequency(frequency) + air[:, None])[sample]
        size = sigma[sample][..., None]  # [W, J, 1]
        scale = (1 + size.square()).sqrt()
        features = self.join(torch.cat([noisy / scale, (log_amplitude - TYPICAL) / 2], dim=-1)) + geometry[:, None]
        for block in self.blocks:
            features = block(features, around, embedding)
        residual = self.head(functional.layer_norm(features, features.shape[-1:])).float()
        denoised: Tensor = noisy / scale.square() + residual * size / scale
        return denoised
