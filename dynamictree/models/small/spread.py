"""How far sizes of a motion lie from what shape and wind tell: leaves that flutter beside leaves that do not.

A size is A (p e^γ)^(α / 2), p the power of a complex normal number. The spread α is 0 of a sure size, 1 of a gust's.
"""

import math

import numpy as np
import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

from dynamictree.models.wind import REFERENCE_SPEED


def speed_terms(log_speed: Float32[Tensor, "*S"]) -> Float32[Tensor, "*S U"]:
    """Shares of the stored speeds, evenly spaced in ln from 1 to 25 m/s, as trees were made at, at a speed."""
    count = 5  # held out, ln energy of k = 7 to 15 errs by 0.19, with one gain for all speeds by 0.28 (168 trees)
    place = (log_speed / (2 * math.log(REFERENCE_SPEED))).clamp(0, 1) * (count - 1)
    return (1 - (place[..., None] - torch.arange(count)).abs()).clamp_min(0)


def at_speed(stored: Float32[Tensor, "U J 3"], log_speed: Float32[Tensor, ""]) -> Float32[Tensor, "J 3"]:
    """Interpolate what is stored at the speeds of `speed_terms`."""
    return torch.einsum("u,ujx->jx", speed_terms(log_speed), stored)


def log_surplus(spread: Float32[Tensor, "*S"]) -> Float32[Tensor, "*S"]:
    """Ln of the mean square over A² of sizes of a spread."""
    return np.euler_gamma * spread + torch.lgamma(1 + spread)


def power_of(field: Complex64[Tensor, "*S"]) -> Float32[Tensor, "*S"]:
    """|z|², without the square root of |z|."""
    power: Tensor = torch.view_as_real(field).square().sum(dim=-1)
    return power


def of_unit_power(field: Complex64[Tensor, "V J 3"]) -> Complex64[Tensor, "V J 3"]:
    """The field of a mean square of 1."""
    return field / power_of(field).mean(dim=0).clamp_min(torch.finfo(torch.float32).tiny).sqrt()


def sized(field: Complex64[Tensor, "V J 3"], spread: Float32[Tensor, "J 3"]) -> Complex64[Tensor, "V J 3"]:
    """Give a complex normal field sizes of another spread about a mean square of 1; phases stay."""
    field = of_unit_power(field)
    power = power_of(field) + 1e-2  # where the phase turns within a voxel, sizes go no steeper
    return field * torch.exp(((spread - 1) * power.log() - torch.lgamma(1 + spread)) / 2)
