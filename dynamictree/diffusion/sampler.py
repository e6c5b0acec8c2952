"""Noise schedules and samplers: functions of a denoiser, a start and numbers. Only the start is random."""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float, Float32
from torch import Tensor

NUM_STEPS = 1000
Denoise = Callable[[Tensor, float], Tensor]
"""Function from a noisy signal and its σ to the expected clean signal."""


def linear_schedule() -> Float32[Tensor, " L"]:
    """Return ᾱ of each step, the variance of the signal in the noisy one, for β from 1e-4 to 0.02 in equal steps.

    Ho et al. 2020 and XCube have this schedule.
    """
    betas = torch.linspace(1e-4, 0.02, NUM_STEPS, dtype=torch.float64)
    return (1 - betas).cumprod(dim=0).float()


def predicted_clean(
    noisy: Float[Tensor, "*batch C"], noise: Float[Tensor, "*batch C"], alpha_bar: Float[Tensor, "..."]
) -> Float[Tensor, "*batch C"]:
    """Return the clean signal x₀ that predicted noise ε implies: (x − √(1 − ᾱ) ε) / √ᾱ."""
    return (noisy - (1 - alpha_bar).sqrt() * noise) / alpha_bar.sqrt()


def karras_schedule(num_steps: int, *, sigma_min: float, sigma_max: float, rho: float = 7.0) -> Float32[Tensor, " _"]:
    """Return num_steps + 1 noise levels, the last zero. Karras et al. 2022, eq. 5."""
    ramp = torch.linspace(0, 1, num_steps)
    sigmas = (sigma_max ** (1 / rho) + ramp * (sigma_min ** (1 / rho) - sigma_max ** (1 / rho))) ** rho
    return torch.cat([sigmas, torch.zeros(1)])


def sample_dpm_multistep(
    denoise: Denoise,
    start: Float[Tensor, "..."],
    sigmas: Float32[Tensor, " _"],
    *,
    on_step: Callable[[int, int], None] | None = None,
) -> Float[Tensor, "..."]:
    """DPM-Solver++(2M), second order with one evaluation per step. Lu et al. 2022, arXiv 2211.01095, algorithm 2.

    In t = -ln σ, with h the step in t and r the last step over this one, D is extrapolated along the last two steps:
    D' = D + (D - D_last) / (2 r). The first step and the last, to σ = 0, are of first order. `start` is unit noise
    times the first of `sigmas`, which fall (`karras_schedule`). `on_step` receives the completed steps and their total.
    """
    signal, total = start, len(sigmas) - 1
    last_clean: Tensor | None = None
    for index in range(total):
        sigma, next_sigma = float(sigmas[index]), float(sigmas[index + 1])
        clean = denoise(signal, sigma)
        expected = clean
        if last_clean is not None and next_sigma > 0:
            ratio = math.log(float(sigmas[index - 1]) / sigma) / math.log(sigma / next_sigma)
            expected = clean + (clean - last_clean) / (2 * ratio)
        signal = expected + (next_sigma / sigma) * (signal - expected)
        last_clean = clean
        if on_step is not None:
            on_step(index + 1, total)
    return signal


def sample_ddim(
    predict_clean: Callable[[Tensor, int], Tensor],
    start: Float[Tensor, "..."],
    schedule: Float32[Tensor, " L"],
    *,
    num_steps: int = 100,
    on_step: Callable[[int, int], None] | None = None,
) -> Float[Tensor, "..."]:
    """DDIM, deterministic (η = 0), evenly spaced. Song et al. 2021, arXiv 2010.02502, eq. 12; 100 steps in the paper.

    `predict_clean` maps a noisy signal and its step's index to the clean signal (`predicted_clean`), `start` is unit
    noise, and `on_step` receives the completed steps and their total. The last step of the schedule is included.
    """
    steps = torch.linspace(len(schedule) - 1, 0, num_steps).round().long().tolist()
    signal = start
    for index, step in enumerate(steps):
        alpha_bar = schedule[step]
        next_alpha_bar = schedule[steps[index + 1]] if index + 1 < num_steps else torch.ones_like(alpha_bar)
        clean = predict_clean(signal, step)
        noise = (signal - alpha_bar.sqrt() * clean) / (1 - alpha_bar).sqrt()
        signal = next_alpha_bar.sqrt() * clean + (1 - next_alpha_bar).sqrt() * noise
        if on_step is not None:
            on_step(index + 1, num_steps)
    return signal
