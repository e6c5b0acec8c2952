"""Real channels of a complex spectrum: the layout that the networks read and write."""

import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

CHANNELS = 6
"""Real parts of x, y, z, then imaginary parts."""


def pack_channels(spectrum: Complex64[Tensor, "*batch 3"]) -> Float32[Tensor, "*batch 6"]:
    """Complex (x, y, z) to (re x, re y, re z, im x, im y, im z)."""
    return torch.cat([spectrum.real, spectrum.imag], dim=-1)


def unpack_channels(channels: Float32[Tensor, "*batch 6"]) -> Complex64[Tensor, "*batch 3"]:
    """Undo `pack_channels`."""
    return torch.complex(channels[..., :3].contiguous(), channels[..., 3:].contiguous())
