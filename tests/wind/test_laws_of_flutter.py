"""Laws of flutter: when it sets in, how fast it is."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Complex64

from dynamictree.requests import Wind
from dynamictree.rig.flutter import flutter_of
from dynamictree.rig.pose import Skeleton, Weights
from dynamictree.rig.rig import Rig
from dynamictree.spectrum import to_motion
from dynamictree.wind.flutter import (
    FASTEST_HZ,
    FLAP_RAD,
    SLOWEST_HZ,
    TWIG_SHARE,
    TWIST_RAD,
    gust_speeds,
    leaf_frequencies,
)
from lab.dataset.wind import resonance, unit_turns
from tests.clouds import still_spectrum

NUM_FRAMES, FRAME_S = 200, 1 / 24
NUM_TWIGS, LEAVES_PER_TWIG = 300, 2
TWIG = np.repeat(np.arange(NUM_TWIGS), LEAVES_PER_TWIG)


def turns(speed_m_s: float, *, seed: int = 0, gust: float = 0.3) -> Complex64[np.ndarray, "M J 3"]:
    """Turns of many leaves that lie along x, two on each twig of one stem."""
    parent = np.concatenate([[-1, 0], np.ones(NUM_TWIGS), 2 + TWIG]).astype(np.int32)
    places = np.tile(np.float32([0.3, 0, 0]), (len(parent), 1))
    skeleton = Skeleton(parent=parent, foot_m=0 * places, reach_m=places, in_surface=np.zeros(len(parent), np.bool_))
    vertices = Weights(rows=np.zeros((1, 2), np.int32), shares=np.float32([[1, 0]]))
    turns = np.zeros((len(parent), 1, 3), np.complex64)
    rig = Rig(skeleton=skeleton, turns=turns, vertices=vertices, voxels=vertices, num_frames=NUM_FRAMES)
    flutter = flutter_of(rig, replace(still_spectrum(NUM_FRAMES), seed=seed))
    sizes = flutter.sizes(gust_speeds(Wind(speed_m_s=speed_m_s, gust=gust)))
    return (sizes[:, None, None] * flutter.modes())[-len(TWIG) :]


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
    twist, flap = np.sqrt((motion[..., 0] ** 2).mean()), np.sqrt((motion[..., 1:] ** 2).sum(axis=2).mean())
    for share in (twist / TWIST_RAD, flap / FLAP_RAD):
        assert least <= share <= 1.05 * most


@pytest.mark.parametrize("of", ["rig", "simulator"])
def test_leaves_of_a_twig_do_half_of_their_flutter_together(of: str, rng) -> None:
    frequency_hz = np.fft.rfftfreq(NUM_FRAMES, FRAME_S)
    twist = turns(40.0)[:, :, 0] if of == "rig" else unit_turns(TWIG, frequency_hz, rng)[:, 1]
    modes = twist.reshape(NUM_TWIGS, LEAVES_PER_TWIG, -1)
    together = (modes[:, 0] * modes[:, 1].conj()).real.sum(axis=1)
    sizes = (np.abs(modes) ** 2).sum(axis=2).mean(axis=1)
    assert together.sum() / sizes.sum() == pytest.approx(TWIG_SHARE, abs=0.06)


def test_a_gust_flutters_what_the_mean_wind_leaves_still() -> None:
    assert not turns(1.2, gust=0.0).any()
    assert np.abs(turns(3.0, gust=0.6)).mean() > 1.5 * np.abs(turns(3.0, gust=0.0)).mean()
