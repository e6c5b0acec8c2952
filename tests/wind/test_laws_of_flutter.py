"""Laws of flutter: when it sets in, how fast it is."""

import numpy as np
import pytest
from jaxtyping import Complex64

from dynamictree.requests import Wind
from dynamictree.spectrum import to_motion
from dynamictree.wind.flutter import (
    FASTEST_HZ,
    FLAP_RAD,
    SLOWEST_HZ,
    TWIG_SHARE,
    TWIST_RAD,
    leaf_frequencies,
    resonance,
    turn_modes,
)

ALONG, ACROSS = np.float32([1, 0, 0]), np.float32([0, 0, 1])
NUM_FRAMES, FRAME_S = 200, 1 / 24
NUM_TWIGS, LEAVES_PER_TWIG = 300, 2


def turns(speed_m_s: float, *, seed: int = 0, gust: float = 0.3) -> Complex64[np.ndarray, "M J 3"]:
    """Turns of many leaves that lie along x, two on each twig."""
    twig = np.repeat(np.arange(NUM_TWIGS), LEAVES_PER_TWIG)
    along, across = (np.tile(one, (len(twig), 1)) for one in (ALONG, ACROSS))
    frequency_hz = np.fft.rfftfreq(NUM_FRAMES, FRAME_S)[:-1]
    wind = Wind(speed_m_s=speed_m_s, gust=gust)
    return turn_modes(along, across, twig, wind, frequency_hz, np.random.default_rng(seed))


def test_leaves_have_frequencies_of_their_own_in_the_measured_range(rng) -> None:
    own = leaf_frequencies(2000, rng)
    assert SLOWEST_HZ <= own.min() < 2.1
    assert 7.8 < own.max() <= FASTEST_HZ
    frequency = np.fft.rfftfreq(100, 1 / 24)
    shape = resonance(frequency, own)
    np.testing.assert_allclose((shape**2).sum(axis=1), 1)
    assert (shape[:, frequency < SLOWEST_HZ] == 0).all()
    assert (np.abs(frequency[shape.argmax(axis=1)] - own) < 0.25).all()


def test_turns_are_those_of_the_seed_and_lie_in_the_measured_band() -> None:
    modes = turns(12.0)
    np.testing.assert_array_equal(modes, turns(12.0))
    assert (modes != turns(12.0, seed=1)).any()
    frequency_hz = np.arange(modes.shape[1]) / (NUM_FRAMES * FRAME_S)
    power = (np.abs(modes) ** 2).sum(axis=(0, 2))
    assert (power[frequency_hz < SLOWEST_HZ] == 0).all()
    assert power[frequency_hz <= FASTEST_HZ].sum() > 0.85 * power.sum()


@pytest.mark.parametrize(
    ("speed_m_s", "least", "most"), [(1.5, 0, 0), (2.0, 0, 0.02), (5.0, 0.05, 0.4), (40.0, 0.95, 1.0)]
)
def test_turns_of_a_loop_grow_from_nothing_to_their_full_size(speed_m_s: float, least: float, most: float) -> None:
    modes = turns(speed_m_s, gust=0.0)
    motion = to_motion(modes, NUM_FRAMES)
    size = motion.std(axis=0)  # [M, 3]
    assert np.abs(size[:, 1]).max() == 0  # neither along the leaf nor about its stalk
    for axis, full in ((0, TWIST_RAD), (2, FLAP_RAD)):
        share = np.sqrt((size[:, axis] ** 2).mean()) / full
        assert least <= share <= 1.05 * most


def test_leaves_of_a_twig_do_half_of_their_flutter_together() -> None:
    modes = turns(40.0)[:, :, 2].reshape(NUM_TWIGS, LEAVES_PER_TWIG, -1)
    together = (modes[:, 0] * modes[:, 1].conj()).real.sum(axis=1)
    sizes = (np.abs(modes) ** 2).sum(axis=2).mean(axis=1)
    assert together.sum() / sizes.sum() == pytest.approx(TWIG_SHARE, abs=0.06)


def test_a_gust_flutters_what_the_mean_wind_leaves_still() -> None:
    assert not turns(1.2, gust=0.0).any()
    assert np.abs(turns(3.0, gust=0.6)).mean() > 1.5 * np.abs(turns(3.0, gust=0.0)).mean()
