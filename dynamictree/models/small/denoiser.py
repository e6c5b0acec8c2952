"""Denoiser of the small model: frequencies are independent, and all of a tree share one pass.

The network is F of EDM (Karras et al. 2022, arXiv 2206.00364, eq. 7): D(x; σ) = c_skip x + c_out F(c_in x), for the
whitened spectrum, whose variance is 1.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float32, Int64
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.diffusion.channels import CHANNELS, sinusoid
from dynamictree.models.small.features import NUM_FEATURES, NUM_WIND, TreeFeatures, node_features
from dynamictree.models.small.mixer import MixerBlock, Neighbourhood

NOISE_FEATURES = 64


@dataclass(frozen=True, kw_only=True)
class DenoiserShape:
    """Widths and depth of the denoiser."""

    width: int = 64
    embedding: int = 96
    num_blocks: int = 6


class Denoiser(nn.Module):
    """The network F. Frequencies are an axis between nodes and channels, and are independent."""

    def __init__(self, *, num_frequencies: int, shape: DenoiserShape) -> None:
        super().__init__()
        self.describe = nn.Sequential(
            nn.Linear(NUM_FEATURES, 2 * shape.width), nn.SiLU(), nn.Linear(2 * shape.width, shape.width)
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
        self,
        nodes: TreeFeatures,
        wind: Float32[Tensor, "B 4"],
        *,
        frequency: Int64[Tensor, "B J"],
        log_amplitude: Float32[Tensor, "W J 3"],
        neighbourhood: Neighbourhood,
    ) -> "DenoiserCondition":
        """Compute the step-independent condition of trees whose features are on their nodes (`coarsen_features`)."""
        air = torch.cat([wind[:, :NUM_WIND], nodes.height_m.log()[:, None]], dim=1)
        return DenoiserCondition(
            geometry=self.describe(node_features(nodes, wind)).float(),
            air=self.describe_wind(air).float(),
            frequency=frequency,
            log_amplitude=log_amplitude,
            neighbourhood=neighbourhood,
            tree_of_node=nodes.grids.levels[0].sample_of_row,
        )

    def forward(
        self, scaled: Float32[Tensor, "W J 6"], sigma: Float32[Tensor, "B J"], condition: "DenoiserCondition"
    ) -> Float32[Tensor, "W J 6"]:
        """Compute F(c_in x; ln σ)."""
        noise_scale = 25.0  # ln σ runs over ± 4; times this, the sinusoids' periods cover it from coarse to fine
        typical_log_amplitude = -8.0  # over the height
        noise_features = sinusoid(noise_scale * sigma.log(), NOISE_FEATURES)
        level_and_bin = self.embed_noise(noise_features) + self.embed_frequency(condition.frequency)
        embedding = self.mix(level_and_bin + condition.air[:, None])  # [B, J, E]
        size = (condition.log_amplitude - typical_log_amplitude) / 2
        features = self.join(torch.cat([scaled, size], dim=-1)) + condition.geometry[:, None]
        for block in self.blocks:
            features = block(features, condition.neighbourhood, embedding, condition.tree_of_node)
        residual: Tensor = self.head(functional.layer_norm(features, features.shape[-1:])).float()
        return residual


@dataclass(frozen=True, kw_only=True, eq=False)
class DenoiserCondition:
    """Condition of the denoiser: trees, winds and frequencies."""

    geometry: Float32[Tensor, "W C"]
    air: Float32[Tensor, "B E"]
    frequency: Int64[Tensor, "B J"]  # bins
    log_amplitude: Float32[Tensor, "W J 3"]  # over the height
    neighbourhood: Neighbourhood
    tree_of_node: Int64[Tensor, " W"]

    def of_band(self, band: slice) -> "DenoiserCondition":
        """Return the condition of some frequencies."""
        return replace(self, frequency=self.frequency[:, band], log_amplitude=self.log_amplitude[:, band])


def denoise(
    network: Denoiser, noisy: Float32[Tensor, "W J 6"], sigma: Float32[Tensor, "B J"], condition: DenoiserCondition
) -> Float32[Tensor, "W J 6"]:
    """Compute D(x; σ), the expected whitened spectrum."""
    at_node = sigma[condition.tree_of_node][..., None]  # [W, J, 1]
    scale = (1 + at_node.square()).sqrt()
    predicted: Tensor = network(noisy / scale, sigma, condition)
    return noisy / scale.square() + predicted * at_node / scale
