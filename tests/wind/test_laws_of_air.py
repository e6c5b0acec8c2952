"""Laws of the turbulent field: variance, coherence, fronts, gusts and lulls."""

import numpy as np
import pytest

from dynamictree.spectrum import FPS, NUM_FRAMES, Wind
from dynamictree.wind.air import COMPONENTS, DECAY_ACROSS, SKEW, single_gust, turbulent_air, von_karman_shares

BINS_HZ = np.arange(1, 16) * FPS / NUM_FRAMES
TIMES_S = np.arange(NUM_FRAMES) / FPS
DRAWS = 150


def drawn(points: np.ndarray, wind: Wind) -> np.ndarray:
    """Velocities at points in many draws, [D, 3, M, T]."""
    return np.stack(
        [
            turbulent_air(wind, 10.0, BINS_HZ, TIMES_S, np.random.default_rng(seed)).velocity(np.float32(points))
            for seed in range(DRAWS)
        ]
    )


@pytest.mark.parametrize("direction_deg", [0.0, 90.0])
def test_gusts_have_the_deviation_that_the_wind_says(direction_deg: float) -> None:
    wind = Wind(speed_m_s=6.0, gust=0.3, direction_deg=direction_deg)
    velocity = drawn(np.zeros((1, 3)), wind)
    spread = velocity.std(axis=(0, 2, 3))
    order = [0, 1, 2] if direction_deg == 0 else [1, 0, 2]
    np.testing.assert_allclose(spread[order], 1.8 * COMPONENTS, rtol=0.1)
    assert np.abs(velocity.mean(axis=(0, 2, 3))).max() < 0.02 * 6


def test_places_agree_as_davenport_says() -> None:
    apart = np.array([0.0, 0.3, 1.0, 3.0])
    points = np.stack([0 * apart, apart, 0 * apart], axis=1)
    hat = np.fft.rfft(drawn(points, Wind(speed_m_s=5.0))[:, 1], axis=2)  # [D, M, W], the component without skew
    for k in (1, 4, 10):
        cross = (hat[:, 1:, k] * hat[:, :1, k].conj()).mean(axis=0)
        power = np.sqrt((np.abs(hat[:, 1:, k]) ** 2).mean(axis=0) * (np.abs(hat[:, 0, k]) ** 2).mean())
        expected = np.exp(-DECAY_ACROSS * BINS_HZ[k - 1] * apart[1:] / 5.0)
        np.testing.assert_allclose(np.abs(cross) / power, expected, atol=0.15)


def test_fronts_travel_downwind_at_the_mean_speed() -> None:
    points = np.array([[0.0, 0, 0], [0.4, 0, 0]])
    hat = np.fft.rfft(drawn(points, Wind(speed_m_s=4.0, direction_deg=0.0))[:, 1], axis=2)
    for k in (2, 5):
        lag = np.angle((hat[:, 0, k] * hat[:, 1, k].conj()).mean()) / (2 * np.pi * BINS_HZ[k - 1])
        assert lag == pytest.approx(0.1, rel=0.15)


def test_there_are_gusts_and_lulls_and_gusts_are_the_stronger() -> None:
    along = drawn(np.zeros((1, 3)), Wind(speed_m_s=6.0, direction_deg=0.0))[:, 0, 0]
    standard = along / along.std()
    assert (standard**3).mean() == pytest.approx(6 * SKEW, abs=0.25)
    sizes = along.std(axis=1)
    assert sizes.std() / sizes.mean() > 0.15  # one of two minutes is calmer


def test_fast_gusts_are_weak_and_stronger_in_a_fast_wind() -> None:
    slow, fast = (von_karman_shares(BINS_HZ, 18 / speed) for speed in (1.0, 25.0))
    assert slow.sum() == pytest.approx(1)
    np.testing.assert_allclose(np.log(slow[14] / slow[4]) / np.log(3), -5 / 3, atol=0.01)
    assert fast[-1] > 1.15 * slow[-1]


def test_a_single_gust_is_one_gust() -> None:
    velocity = single_gust(np.arange(400) / FPS).velocity(np.zeros((1, 3), np.float32))
    assert velocity[0, 0].argmax() == 0
    blown = velocity[0, 0] - np.median(velocity[0, 0])  # over the time between gusts
    assert blown[0] == pytest.approx(3.0, rel=0.02)
    assert np.abs(blown[36:-36]).max() < 0.01
    assert (velocity[1:] == 0).all()
