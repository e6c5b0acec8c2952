"""How far sizes of a motion lie from what shape and wind tell: leaves that flutter beside leaves that do not.

A size is A (p e^γ)^(α / 2), p the power of a complex normal number. The spread α is 0 of a sure size, 1 of a gust's.
"""

import math

import numpy as np
import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

from dynamictree.models.wind import REFERENCE_SPEED


def speed_terms(log_speed: Float32[Tensor, "*S"]) -> Float32[Tensor, "*S 3"]:
    """Terms of a spread: 1, l and l², l = ln(U / REFERENCE_SPEED); U within 1 to 25 m/s, as trees were made at."""
    most = math.log(REFERENCE_SPEED)
    return (log_speed - most).clamp(-most, most)[..., None] ** torch.arange(3)


def log_surplus(spread: Float32[Tensor, "*S"]) -> Float32[Tensor, "*S"]:
    """Ln of the mean square over A² of sizes of a spread."""
    return np.euler_gamma * spread + torch.lgamma(1 + spread)


def sized(field: Complex64[Tensor, "V J 3"], spread: Float32[Tensor, "J 3"]) -> Complex64[Tensor, "V J 3"]:
    """Give a complex normal field sizes of another spread about a mean square of 1; phases stay."""
    field = field / field.abs().square().mean(dim=0).clamp_min(torch.finfo(torch.float32).tiny).sqrt()
    power = field.abs().square() + 1e-2  # where the phase turns within a voxel, sizes go no steeper
    return field * torch.exp(((spread - 1) * power.log() - torch.lgamma(1 + spread)) / 2)
