"""Inputs and outputs of the networks: real channels of a complex spectrum, sinusoids of a noise level."""

import math

import torch
from jaxtyping import Complex64, Float, Float32
from torch import Tensor

CHANNELS = 6
"""Real parts of x, y, z, then imaginary parts."""
MAX_PERIOD = 10_000.0


def pack_channels(spectrum: Complex64[Tensor, "*batch 3"]) -> Float32[Tensor, "*batch 6"]:
    """Convert complex (x, y, z) to (re x, re y, re z, im x, im y, im z)."""
    return torch.cat([spectrum.real, spectrum.imag], dim=-1)


def unpack_channels(channels: Float32[Tensor, "*batch 6"]) -> Complex64[Tensor, "*batch 3"]:
    """Invert `pack_channels`."""
    return torch.complex(channels[..., :3].contiguous(), channels[..., 3:].contiguous())


def sinusoid(values: Float[Tensor, "*batch"], width: int) -> Float[Tensor, "*batch {width}"]:
    """Return cosines and sines of `width` / 2 frequencies in geometric progression, with periods up to MAX_PERIOD."""
    half = width // 2
    frequencies = torch.exp(-math.log(MAX_PERIOD) * torch.arange(half, device=values.device) / half)
    angles = values[..., None].float() * frequencies
    return torch.cat([angles.cos(), angles.sin()], dim=-1)
