"""The sampler against distributions whose best denoiser is known."""

import pytest
import torch

from dynamictree.diffusion.sampler import (
    karras_schedule,
    linear_schedule,
    predicted_clean,
    sample_ddim,
    sample_dpm_multistep,
)
from lab.training.loss import denoising_loss

VARIANCE = torch.tensor([4.0, 1.0, 0.01])


def best_denoiser(noisy: torch.Tensor, sigma: float) -> torch.Tensor:
    """E[x | x + σn] for independent Gaussians of VARIANCE."""
    return noisy * VARIANCE / (VARIANCE + sigma**2)


def exact_end(start: torch.Tensor, sigma: float) -> torch.Tensor:
    """Where the probability flow of those Gaussians ends."""
    return start * (VARIANCE / (VARIANCE + sigma**2)).sqrt()


def test_the_sampler_follows_the_probability_flow_to_second_order() -> None:
    start = torch.randn(50, 3, generator=torch.Generator().manual_seed(0)) * 5
    errors = []
    for num_steps in (10, 20, 40):
        sigmas = karras_schedule(num_steps, sigma_min=0.5, sigma_max=5.0)[:-1]  # stop before the last, Euler step
        end = sample_dpm_multistep(best_denoiser, start, sigmas)
        reference = exact_end(start, 5.0) / exact_end(torch.ones(3), 0.5)
        errors.append(float((end - reference).abs().max()))
    assert errors[0] / errors[1] > 3.2
    assert errors[1] / errors[2] > 3.2


def test_samples_have_the_distribution_that_the_denoiser_knows() -> None:
    sigmas = karras_schedule(18, sigma_min=0.005, sigma_max=40.0)
    start = torch.randn(20_000, 3, generator=torch.Generator().manual_seed(0)) * sigmas[0]
    samples = sample_dpm_multistep(best_denoiser, start, sigmas)
    torch.testing.assert_close(samples.var(dim=0), VARIANCE, rtol=0.12, atol=0)


def test_steps_are_reported_and_an_exception_passes_through() -> None:
    steps: list[tuple[int, int]] = []
    sigmas = karras_schedule(4, sigma_min=0.1, sigma_max=5.0)
    sample_dpm_multistep(best_denoiser, torch.ones(3), sigmas, on_step=lambda done, total: steps.append((done, total)))
    assert steps == [(1, 4), (2, 4), (3, 4), (4, 4)]

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample_dpm_multistep(best_denoiser, torch.ones(3), sigmas, on_step=stop)


def test_the_loss_of_the_identity_skip_is_one_whatever_the_noise() -> None:
    """With unit variance, x / (1 + σ²) leaves σ² / (1 + σ²): the weight makes it 1."""
    generator = torch.Generator().manual_seed(0)
    clean, noise = (torch.randn(40_000, 1, 6, generator=generator) for _ in range(2))
    for size in (0.05, 1.0, 8.0):
        sigma = torch.full((40_000, 1, 1), size)
        loss = denoising_loss((clean + size * noise) / (1 + size**2), clean, sigma)
        assert float(loss[0]) == pytest.approx(1, abs=0.01)


def test_ddim_takes_noise_to_the_distribution_that_the_predictor_knows() -> None:
    schedule, variance = linear_schedule(), torch.tensor([4.0, 0.25])

    def predict_clean(noisy: torch.Tensor, step: int) -> torch.Tensor:
        alpha_bar = schedule[step]
        expected_noise = (1 - alpha_bar).sqrt() * noisy / (alpha_bar * variance + 1 - alpha_bar)
        return predicted_clean(noisy, expected_noise, alpha_bar)

    steps: list[tuple[int, int]] = []
    start = torch.randn(20_000, 2, generator=torch.Generator().manual_seed(0))
    samples = sample_ddim(predict_clean, start, schedule, on_step=lambda *step: steps.append(step))
    torch.testing.assert_close(samples.var(dim=0), variance, rtol=0.08, atol=0)
    assert steps[-1] == (100, 100)
    assert (samples == sample_ddim(predict_clean, start, schedule)).all()
