"""Noise and velocity: what a network predicts, against clean signals and distributions that are known."""

import pytest
import torch

from dynamictree.diffusion.prediction import Prediction, predicted_clean, prediction_target
from dynamictree.diffusion.sampler import sample_ddim
from dynamictree.diffusion.schedule import linear_schedule, schedule_of, zero_terminal

PREDICTIONS: tuple[Prediction, ...] = ("noise", "velocity")
VARIANCE = torch.tensor([4.0, 0.25])


def best_prediction(noisy: torch.Tensor, alpha_bar: torch.Tensor, prediction: Prediction) -> torch.Tensor:
    """E[ε | x] and E[v | x] for independent Gaussians of VARIANCE."""
    whole = alpha_bar * VARIANCE + 1 - alpha_bar
    clean, noise = alpha_bar.sqrt() * VARIANCE * noisy / whole, (1 - alpha_bar).sqrt() * noisy / whole
    return prediction_target(clean, noise, alpha_bar, prediction)


@pytest.mark.parametrize("prediction", PREDICTIONS)
def test_the_target_implies_the_clean_signal_at_every_step(prediction: Prediction) -> None:
    schedule = schedule_of(prediction)
    clean, noise = torch.randn(2, 1000, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    alpha_bar = schedule.alpha_bar.double()[:, None]
    noisy = alpha_bar.sqrt() * clean + (1 - alpha_bar).sqrt() * noise
    target = prediction_target(clean, noise, alpha_bar, prediction)
    torch.testing.assert_close(predicted_clean(noisy, target, alpha_bar, prediction), clean, rtol=0, atol=1e-10)


def test_velocity_and_noise_are_two_names_of_one_prediction() -> None:
    """ε = √ᾱ v + √(1 − ᾱ) x."""
    clean, noise = torch.randn(2, 50, 6, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for alpha_bar in torch.tensor([0.001, 0.5, 0.999], dtype=torch.float64):
        noisy = alpha_bar.sqrt() * clean + (1 - alpha_bar).sqrt() * noise
        velocity = prediction_target(clean, noise, alpha_bar, "velocity")
        torch.testing.assert_close(alpha_bar.sqrt() * velocity + (1 - alpha_bar).sqrt() * noisy, noise)


def test_an_error_of_velocity_never_grows_and_one_of_noise_does() -> None:
    noisy, predicted, error = torch.randn(3, 1000, 50, 6, generator=torch.Generator().manual_seed(2))
    for prediction, most in (("velocity", 1.0), ("noise", 157.0)):
        alpha_bar = schedule_of(prediction).alpha_bar[:, None, None]
        off = predicted_clean(noisy, predicted + error, alpha_bar, prediction) - predicted_clean(
            noisy, predicted, alpha_bar, prediction
        )
        growth = (off.abs() / error.abs()).flatten(1).median(dim=1).values.max()
        assert float(growth) == pytest.approx(most, rel=0.1)


def test_the_zero_terminal_schedule_starts_as_the_linear_one_falls_and_ends_without_signal() -> None:
    linear, ended = linear_schedule().alpha_bar, zero_terminal(linear_schedule()).alpha_bar
    assert ended[0] == pytest.approx(float(linear[0]), rel=1e-6)
    assert ended[-1] == 0
    assert (ended.diff() < 0).all()
    assert float((ended.sqrt() - linear.sqrt()).abs().max()) < 0.01


@pytest.mark.parametrize("prediction", PREDICTIONS)
def test_ddim_takes_noise_to_the_distribution_that_the_predictor_knows(prediction: Prediction) -> None:
    schedule = schedule_of(prediction)

    def predict_clean(noisy: torch.Tensor, step: int) -> torch.Tensor:
        alpha_bar = schedule.alpha_bar[step]
        return predicted_clean(noisy, best_prediction(noisy, alpha_bar, prediction), alpha_bar, prediction)

    steps: list[tuple[int, int]] = []
    start = torch.randn(20_000, 2, generator=torch.Generator().manual_seed(0))
    samples = sample_ddim(predict_clean, start, schedule, on_step=lambda *step: steps.append(step))
    torch.testing.assert_close(samples.var(dim=0), VARIANCE, rtol=0.08, atol=0)
    assert steps[-1] == (100, 100)
    assert (samples == sample_ddim(predict_clean, start, schedule)).all()
