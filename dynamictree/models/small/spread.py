"""Spread of a motion's sizes about those predicted from shape and wind: some leaves flutter, others beside them do not.

A size is A p^(α / 2), with p the power of a complex normal number. Spread α is 0 for fixed sizes, 1 for gusts. What
exceeds that, all axes and frequencies share: a leaf flutters in all of them or in none.
"""

import math

import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

from dynamictree.models.wind import REFERENCE_SPEED


def speed_weights(log_speed: Float32[Tensor, "*S"]) -> Float32[Tensor, "*S U"]:
    """Return interpolation weights of a speed between stored ones, which are evenly spaced in ln from 1 to 25 m/s."""
    count = 5  # error of ln energy at k = 7 to 15 is 0.19; 0.28 with one gain for all speeds (168 held-out trees)
    place = (log_speed / (2 * math.log(REFERENCE_SPEED))).clamp(0, 1) * (count - 1)
    return (1 - (place[..., None] - torch.arange(count)).abs()).clamp_min(0)


def at_speed(stored: Float32[Tensor, "U J 3"], log_speed: Float32[Tensor, ""]) -> Float32[Tensor, "J 3"]:
    """Interpolate values stored at the speeds of `speed_weights`."""
    return torch.einsum("u,ujx->jx", speed_weights(log_speed), stored)


def squared_magnitude(field: Complex64[Tensor, "*S"]) -> Float32[Tensor, "*S"]:
    """Compute |z|² without the square root of |z|."""
    power: Tensor = torch.view_as_real(field).square().sum(dim=-1)
    return power


def to_unit_power(field: Complex64[Tensor, "V J 3"]) -> Complex64[Tensor, "V J 3"]:
    """Scale a field to a mean square of 1."""
    return field / squared_magnitude(field).mean(dim=0).clamp_min(torch.finfo(torch.float32).tiny).sqrt()


def with_spread(field: Complex64[Tensor, "V J 3"], spread: Float32[Tensor, "J 3"]) -> Complex64[Tensor, "V J 3"]:
    """Change the spread of the sizes of a complex normal field, at a mean square of 1; phases stay."""
    field, alpha = to_unit_power(field), spread.flatten()
    log_power = (squared_magnitude(field) + 1e-2).log().flatten(1)  # bounded near zeros, where the phase turns fast
    excess = (alpha.square() - 1).clamp_min(0).sqrt()
    shared = torch.outer(excess, excess) / excess.norm().clamp_min(1e-6)
    own = (alpha.clamp_max(1).square() + shared.diag().square()).sqrt() - shared.diag()
    log_square = log_power @ (own.diag() + shared)
    return to_unit_power(field * ((log_square - log_power) / 2).exp().view(field.shape))
