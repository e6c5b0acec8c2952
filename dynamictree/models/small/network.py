"""Preset `small`: foliage network, amplitude network, denoiser of the whitened spectrum, and the numbers between them.

A spectrum has the phases of a field of unit variance: noise of rotating stems (`StemNoise`), which the denoiser changes
on the nodes (level `top` of the pyramid, 32³ of a 128³ grid). Its sizes spread about A like the field's
(`spread.with_spread`). Shape and wind alone decide the whole crown's size: more wind moves it further.
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from dynamictree.models.small.amplitude import AmplitudeNetwork
from dynamictree.models.small.denoiser import Denoiser, DenoiserShape
from dynamictree.models.small.foliage import FoliageNetwork
from dynamictree.models.small.spread import speed_weights
from dynamictree.models.weights_file import StorableNetwork

AXES = 3


@dataclass(frozen=True, kw_only=True)
class SmallPreset:
    """Everything that the weights depend on."""

    resolution: int = 128
    num_frequencies: int = 16
    top: int = 2
    foliage_widths: tuple[int, int, int] = (24, 48, 64)
    amplitude_width: int = 256
    amplitude_depth: int = 2
    denoiser: DenoiserShape = field(default_factory=DenoiserShape)
    sigma_min: float = 0.02
    sigma_max: float = 10.0


class SmallNetwork(StorableNetwork):
    """Foliage and amplitude network, the denoiser of the whitened spectrum, and the statistics between them."""

    KIND, VERSION, PRESET = "dynamictree-small", "13", SmallPreset
    preset: SmallPreset
    common_share: Tensor  # [J], of the power of forces on stems
    spread: Tensor  # [U, J, 3], at the speeds of `speed_weights`
    log_gain: Tensor  # [U, J, 3], ln of the root mean square over A

    def __init__(self, preset: SmallPreset) -> None:
        super().__init__(preset)
        moving = preset.num_frequencies - 1
        self.foliage = FoliageNetwork(widths=preset.foliage_widths)
        self.amplitude = AmplitudeNetwork(
            num_frequencies=preset.num_frequencies, width=preset.amplitude_width, depth=preset.amplitude_depth
        )
        self.denoiser = Denoiser(num_frequencies=preset.num_frequencies, shape=preset.denoiser)
        self.register_buffer("common_share", torch.zeros(moving))
        self.register_buffer("spread", torch.zeros(*speed_weights(torch.zeros(())).shape, moving, AXES))
        self.register_buffer("log_gain", torch.zeros_like(self.spread))
