"""Samplers: functions of a denoiser, a start, and numbers. Chance enters only with the start."""

from collections.abc import Callable

import torch
from jaxtyping import Float, Float32
from torch import Tensor

from dynamictree.diffusion.schedule import NoiseSchedule

Denoise = Callable[[Tensor, float], Tensor]
"""Expected clean signal, from the noisy one and its σ."""


def karras_schedule(num_steps: int, *, sigma_min: float, sigma_max: float, rho: float = 7.0) -> Float32[Tensor, " _"]:
    """num_steps + 1 noise levels, the last zero. Karras et al. 2022, eq. 5."""
    ramp = torch.linspace(0, 1, num_steps)
    sigmas = (sigma_max ** (1 / rho) + ramp * (sigma_min ** (1 / rho) - sigma_max ** (1 / rho))) ** rho
    return torch.cat([sigmas, torch.zeros(1)])


def sample_heun(
    denoise: Denoise,
    start: Float[Tensor, "..."],
    sigmas: Float32[Tensor, " _"],
    *,
    on_step: Callable[[int, int], None] | None = None,
) -> Float[Tensor, "..."]:
    """Second order and deterministic. Karras et al. 2022, algorithm 1.

    Args:
        denoise: expected clean signal of a noisy one and its noise level.
        start: unit noise times the first of `sigmas`.
        sigmas: noise levels, falling, see `karras_schedule`.
        on_step: called with the steps done and their number.
    """
    signal, total = start, len(sigmas) - 1
    for index in range(total):
        here, there = float(sigmas[index]), float(sigmas[index + 1])
        slope = (signal - denoise(signal, here)) / here
        euler = signal + (there - here) * slope
        if there > 0:
            ahead = (euler - denoise(euler, there)) / there
            euler = signal + (there - here) * (slope + ahead) / 2
        signal = euler
        if on_step is not None:
            on_step(index + 1, total)
    return signal


def sample_ddim(
    predict_noise: Callable[[Tensor, int], Tensor],
    start: Float[Tensor, "..."],
    schedule: NoiseSchedule,
    *,
    num_steps: int = 100,
    on_step: Callable[[int, int], None] | None = None,
) -> Float[Tensor, "..."]:
    """Deterministic (η = 0) and evenly spaced. Song et al. 2021, arXiv 2010.02502, eq. 12; 100 steps in the paper.

    Args:
        predict_noise: ε of a noisy signal and the index of its step.
        start: unit noise.
        schedule: what the network was trained with.
        num_steps: of the schedule's steps, evenly spaced, the last included.
        on_step: called with the steps done and their number.
    """
    steps = torch.linspace(len(schedule.alpha_bar) - 1, 0, num_steps).round().long().tolist()
    signal = start
    for index, step in enumerate(steps):
        here = schedule.alpha_bar[step]
        there = schedule.alpha_bar[steps[index + 1]] if index + 1 < num_steps else torch.tensor(1.0)
        noise = predict_noise(signal, step)
        clean = (signal - (1 - here).sqrt() * noise) / here.sqrt()
        signal = there.sqrt() * clean + (1 - there).sqrt() * noise
        if on_step is not None:
            on_step(index + 1, num_steps)
    return signal
