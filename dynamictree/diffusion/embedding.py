"""Sinusoidal embedding of a noise level or a diffusion step."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

MAX_PERIOD = 10_000.0


def sinusoid(values: Float[Tensor, "*batch"], width: int) -> Float[Tensor, "*batch {width}"]:
    """Cosines and sines of `width` / 2 frequencies in geometric progression; the longest period is MAX_PERIOD."""
    half = width // 2
    frequencies = torch.exp(-math.log(MAX_PERIOD) * torch.arange(half, device=values.device) / half)
    angles = values[..., None].float() * frequencies
    return torch.cat([angles.cos(), angles.sin()], dim=-1)
