"""Noise schedule of DDPM: share of the signal at each step, and the clean signal that predicted noise implies."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32
from torch import Tensor

NUM_STEPS = 1000
BETAS = (1e-4, 0.02)  # Ho et al. 2020, and XCube


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseSchedule:
    """ᾱ of each step: variance of the signal in the noisy one."""

    alpha_bar: Float32[Tensor, " L"]


def linear_schedule(num_steps: int = NUM_STEPS) -> NoiseSchedule:
    """β from 1e-4 to 0.02 in equal steps."""
    betas = torch.linspace(*BETAS, num_steps, dtype=torch.float64)
    return NoiseSchedule(alpha_bar=(1 - betas).cumprod(dim=0).float())


def predicted_clean(
    noisy: Float[Tensor, "*batch C"], noise: Float[Tensor, "*batch C"], alpha_bar: Float[Tensor, "..."]
) -> Float[Tensor, "*batch C"]:
    """The clean signal x₀ that predicted noise ε implies: (x − √(1 − ᾱ) ε) / √ᾱ."""
    return (noisy - (1 - alpha_bar).sqrt() * noise) / alpha_bar.sqrt()
