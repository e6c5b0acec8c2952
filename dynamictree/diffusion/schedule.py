"""Noise schedule of DDPM: share of the signal at each step."""

from dataclasses import dataclass

import torch
from jaxtyping import Float32
from torch import Tensor

from dynamictree.diffusion.prediction import Prediction

NUM_STEPS = 1000
BETAS = (1e-4, 0.02)  # Ho et al. 2020, and XCube


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseSchedule:
    """ᾱ of each step: variance of the signal in the noisy one."""

    alpha_bar: Float32[Tensor, " L"]

    def to(self, device: torch.device) -> "NoiseSchedule":
        """The same on a device."""
        return NoiseSchedule(alpha_bar=self.alpha_bar.to(device))


def linear_schedule(num_steps: int = NUM_STEPS) -> NoiseSchedule:
    """β from 1e-4 to 0.02 in equal steps."""
    betas = torch.linspace(*BETAS, num_steps, dtype=torch.float64)
    return NoiseSchedule(alpha_bar=(1 - betas).cumprod(dim=0).float())


def zero_terminal(schedule: NoiseSchedule) -> NoiseSchedule:
    """The same with nothing of the signal at the last step, which is what sampling starts from.

    √ᾱ is shifted and scaled, and the first step stays as it is. Lin et al. 2023, arXiv 2305.08891, algorithm 1.
    """
    root = schedule.alpha_bar.sqrt()
    return NoiseSchedule(alpha_bar=((root - root[-1]) * root[0] / (root[0] - root[-1])).square())


def schedule_of(prediction: Prediction) -> NoiseSchedule:
    """The linear schedule; for velocity with a last step of noise alone, of which ε could say nothing."""
    return linear_schedule() if prediction == "noise" else zero_terminal(linear_schedule())
