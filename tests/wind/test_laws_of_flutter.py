"""Laws of flutter: when it sets in, how fast it is."""

import numpy as np

from dynamictree.wind.flutter import (
    FASTEST_HZ,
    SLOWEST_HZ,
    STILL_M_S,
    critical_speeds,
    leaf_frequencies,
    line,
    onset,
)


def test_nothing_flutters_below_the_still_speed_and_most_leaves_do_at_five(rng: np.random.Generator) -> None:
    critical = critical_speeds(5000, rng)
    moving = [
        (onset(np.full((5000, 1), speed, np.float32), critical) > 0).mean() for speed in (STILL_M_S, 2.0, 5.0, 12.0)
    ]
    assert moving[0] == 0
    assert moving[1] < 0.05
    assert 0.6 < moving[2] < 0.9
    assert moving[3] > 0.99


def test_flutter_grows_with_the_speed_and_not_beyond_its_full_size() -> None:
    speeds = np.linspace(0, 60, 100, dtype=np.float32)
    size = onset(speeds[None], np.array([4.0]))[0]
    assert (np.diff(size) >= 0).all()
    assert size[-1] < 1


def test_leaves_have_frequencies_of_their_own_in_the_measured_range(rng: np.random.Generator) -> None:
    own = leaf_frequencies(2000, rng)
    assert SLOWEST_HZ <= own.min() < 2.1
    assert 7.8 < own.max() <= FASTEST_HZ
    frequency = np.fft.rfftfreq(100, 1 / 24)
    shape = line(frequency, own)
    np.testing.assert_allclose((shape**2).sum(axis=1), 1)
    assert (shape[:, frequency < SLOWEST_HZ] == 0).all()
    assert (np.abs(frequency[shape.argmax(axis=1)] - own) < 0.25).all()
