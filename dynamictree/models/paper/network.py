"""The paper's network, section 3.4 and appendix B: a sparse encoder of the shape and a U-Net that predicts noise.

Frequencies are generated independently: the noisy spectrum of one bin [V, 6] with the latent condition [V, D]
concatenated; diffusion step and bin modulate every residual block. Frequencies of one tree may share a pass as an axis
between voxels and channels, and stay independent. docs/decisions/diffusion.md lists what the paper leaves open.
"""

from dataclasses import dataclass, field

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, nn

from dynamictree.diffusion.channels import CHANNELS, sinusoid
from dynamictree.models.paper.encoder import SparseEncoder
from dynamictree.models.paper.unet import SparseUNet, UNetShape
from dynamictree.models.weights_file import StorableNetwork
from dynamictree.sparse.level import Pyramid


@dataclass(frozen=True, kw_only=True)
class PaperPreset:
    """Everything that the weights depend on. The defaults are those of the paper's section 6 and hyperparameters."""

    resolution: int = 128  # resolution of the spectrum's grid
    num_frequencies: int = 16
    encoder_base: int = 32
    encoder_widths: tuple[int, ...] = (32, 64, 128)  # one per level, from the finest: 512³, 256³, 128³
    unet: UNetShape = field(default_factory=UNetShape)
    num_steps: int = 100  # DDIM steps

    @property
    def num_halvings(self) -> int:
        """Number of times that the encoder halves its grid."""
        return len(self.encoder_widths) - 1

    @property
    def condition_resolution(self) -> int:
        """Resolution of the voxel grid that the encoder reads."""
        return self.resolution << self.num_halvings

    @property
    def num_levels(self) -> int:
        """Levels of the pyramid of grids, from the encoder's finest to the U-Net's coarsest."""
        return self.num_halvings + len(self.unet.multipliers)


def paper_preset(width: int = 128, resolution: int = 128) -> PaperPreset:
    """Return the preset of the paper's network, or of one in its proportions with `width` base channels."""
    narrow, middle = max(8, width // 4), max(8, width // 2)
    unet = UNetShape(base=width, embedding=4 * width)
    return PaperPreset(resolution=resolution, encoder_base=narrow, encoder_widths=(narrow, middle, width), unet=unet)


@dataclass(frozen=True, kw_only=True, eq=False)
class PaperInputs:
    """Trees as input of the network, besides noise, step and frequency."""

    positions: Float32[Tensor, "X 3"]  # centres of the fine voxels, in [-1, 1]
    normals: Float32[Tensor, "X 3"]
    grids: Pyramid


def unit_positions(coords: Int64[Tensor, "X 3"], resolution: int) -> Float32[Tensor, "X 3"]:
    """Return voxel centres in [-1, 1] of the grid's cube."""
    return (2 * coords + 1).float() / resolution - 1


class PaperNetwork(StorableNetwork):
    """Encoder and U-Net, and the sizes that spectra are divided by."""

    KIND, VERSION, PRESET = "dynamictree-paper", "2", PaperPreset
    preset: PaperPreset
    frequency_sizes: Tensor  # [K], size of a component over the height

    def __init__(self, preset: PaperPreset) -> None:
        super().__init__(preset)
        base, embedding, width = preset.unet.base, preset.unet.embedding, preset.encoder_widths[-1]
        self.encoder = SparseEncoder(base=preset.encoder_base, widths=preset.encoder_widths)
        self.unet = SparseUNet(CHANNELS + width, CHANNELS, preset.unet)
        self.embed_step = nn.Sequential(nn.Linear(base, embedding), nn.SiLU(), nn.Linear(embedding, embedding))
        self.embed_frequency = nn.Embedding(preset.num_frequencies, embedding)
        self.register_buffer("frequency_sizes", torch.ones(preset.num_frequencies))

    def condition(self, inputs: PaperInputs) -> Float[Tensor, "V D"]:
        """Compute the latent condition g."""
        condition: Tensor = self.encoder(inputs.positions, inputs.normals, inputs.grids)
        return condition

    def forward(
        self,
        noisy: Float32[Tensor, "V J 6"],
        step: Int64[Tensor, "B J"],
        frequency: Int64[Tensor, "B J"],
        condition: Float[Tensor, "V D"],
        inputs: PaperInputs,
    ) -> Float[Tensor, "V J 6"]:
        """Predict the noise ε_θ(s_l; l, g, f). Spectra are on level `num_halvings` of the encoder's grids."""
        sinusoids = sinusoid(step.float(), self.preset.unet.base)
        embedding = self.embed_step(sinusoids) + self.embed_frequency(frequency)  # [B, J, E]
        features = torch.cat([noisy, condition[:, None].expand(-1, noisy.shape[1], -1)], dim=-1)
        predicted: Tensor = self.unet(features, inputs.grids, embedding, top=self.preset.num_halvings)
        return predicted
