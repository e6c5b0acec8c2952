"""Endless wind has the loop's statistics, and any moment of it stands by itself."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from dynamictree.modal.turbulence import TurbulentWind, iter_turbulent_sums, turbulent_wind
from dynamictree.requests import MAX_TURBULENT_FRAMES, Wind
from dynamictree.spectrum import SparseVoxelSpectrum

FPS = 24.0
TEN_MINUTES = np.arange(MAX_TURBULENT_FRAMES) / FPS


@pytest.fixture
def wind(spectrum: SparseVoxelSpectrum) -> TurbulentWind:
    return turbulent_wind(spectrum, seed=3)


def test_every_bin_has_the_loops_rms_and_the_lean_its_mean(wind: TurbulentWind) -> None:
    q = wind.coordinates(TEN_MINUTES)
    rms = np.sqrt((np.abs(q[:, 1:]) ** 2).mean(axis=0))
    assert np.abs(rms - 1).max() < 0.1
    assert abs(q[:, 0].real.mean() - 1) < 0.1
    assert not q[:, 0].imag.any()


def test_energy_lies_at_the_bins_frequencies(spectrum: SparseVoxelSpectrum, wind: TurbulentWind) -> None:
    q = wind.coordinates(TEN_MINUTES)
    for k in (1, 5, 15):
        frequency_hz, power = scipy.signal.welch(q[:, k], FPS, nperseg=1000, return_onesided=False)
        assert abs((frequency_hz * power).sum() / power.sum() - spectrum.frequencies_hz[k]) < 0.05
        near = np.abs(frequency_hz - spectrum.frequencies_hz[k]) <= 0.75 / spectrum.period_s
        assert power[near].sum() > 0.9 * power.sum()


def test_neighbours_keep_the_loops_cross_phase(spectrum: SparseVoxelSpectrum, wind: TurbulentWind) -> None:
    pair = spectrum.coefficients[[20, 39]].copy()
    pair[1] *= np.exp(0.9j)  # it moves 0.9 rad before its neighbour
    motion = np.stack(list(_motion(pair, wind, TEN_MINUTES, spectrum.num_frames)))
    up = motion[:, :, 2]  # the turn of the wind's direction leaves it alone
    frequency_hz, cross = scipy.signal.csd(up[:, 0], up[:, 1], FPS, nperseg=400)
    for k in (2, 6, 12):
        now = cross[np.argmin(np.abs(frequency_hz - spectrum.frequencies_hz[k]))]
        assert np.angle(now) == pytest.approx(0.9, rel=0.1)


def test_a_moment_needs_no_moment_before_it(spectrum: SparseVoxelSpectrum, wind: TurbulentWind) -> None:
    whole = list(_motion(spectrum.coefficients, wind, TEN_MINUTES[:700], spectrum.num_frames))
    alone = next(_motion(spectrum.coefficients, wind, TEN_MINUTES[650:651], spectrum.num_frames))
    assert np.array_equal(whole[650], alone)


def test_a_seed_gives_one_wind_and_another_seed_another(spectrum: SparseVoxelSpectrum, wind: TurbulentWind) -> None:
    q = wind.coordinates(TEN_MINUTES[:500])
    assert np.array_equal(turbulent_wind(spectrum, seed=3).coordinates(TEN_MINUTES[:500]), q)
    other = turbulent_wind(spectrum, seed=4).coordinates(TEN_MINUTES[:500])
    assert np.abs(other - q).mean() > 0.5


def test_it_is_bounded_in_a_wild_wind_too(spectrum: SparseVoxelSpectrum) -> None:
    wild = turbulent_wind(replace(spectrum, wind=Wind(speed_m_s=20.0, gust=2.0)))
    q = wild.coordinates(np.arange(0, 36_000, 0.7))
    assert q[:, 0].real.min() >= 0
    assert q[:, 0].real.max() <= 2
    assert np.abs(q[:, 1:]).max() <= np.sqrt(6) * (wild.strength.mean + wild.strength.limit) + 1e-9
    assert np.abs(wild.turn_rad.at(TEN_MINUTES)).max() <= np.pi / 3


def test_it_does_not_come_back_in_an_hour(wind: TurbulentWind) -> None:
    q = wind.coordinates(np.arange(0, 3600, 0.2))[:, 1:]
    windows = np.lib.stride_tricks.sliding_window_view(q, 21, axis=0)[21:]  # windows of one period of the loop
    apart = np.sqrt((np.abs(windows - windows[0]) ** 2)[1:].mean(axis=(1, 2)))
    assert apart[21:].min() > 0.5


def test_a_bare_tree_keeps_its_rhythm_longer_than_one_in_leaf(wind: TurbulentWind) -> None:
    assert wind.bandwidth_hz == pytest.approx(wind.damping_ratio * wind.frequencies_hz)
    spread = np.abs(wind.partial_hz - wind.frequencies_hz[:, None])[1:]
    assert (np.median(spread, axis=1) <= 2 * wind.bandwidth_hz[1:]).all()


def test_gusts_turn_and_strengthen_what_a_steady_wind_does_not(spectrum: SparseVoxelSpectrum) -> None:
    gusty, steady = (turbulent_wind(spectrum, wind=Wind(gust=gust)) for gust in (0.4, 0.0))
    assert np.ptp(steady.coordinates(TEN_MINUTES)[:, 0].real) == 0
    assert not steady.turn_rad.at(TEN_MINUTES).any()
    assert gusty.coordinates(TEN_MINUTES)[:, 0].real.std() > 0.2
    assert np.degrees(gusty.turn_rad.at(TEN_MINUTES).std()) > 5


def test_the_direction_turns_the_whole_displacement(spectrum: SparseVoxelSpectrum, wind: TurbulentWind) -> None:
    straight = replace(wind, turn_rad=replace(wind.turn_rad, amplitude=0 * wind.turn_rad.amplitude))
    time = TEN_MINUTES[1000:1001]
    turned, plain = (next(_motion(spectrum.coefficients, one, time, spectrum.num_frames)) for one in (wind, straight))
    angle = wind.turn_rad.at(time)[0]
    complex_plain, complex_turned = plain[:, 0] + 1j * plain[:, 1], turned[:, 0] + 1j * turned[:, 1]
    np.testing.assert_allclose(complex_turned, complex_plain * np.exp(1j * angle), atol=1e-6)


def _motion(
    coefficients: np.ndarray, wind: TurbulentWind, times_s: np.ndarray, num_frames: int
) -> Iterator[np.ndarray]:
    """Plain sums, turned with the wind's direction."""
    for moved, turn in iter_turbulent_sums(coefficients, wind, times_s, num_frames):
        yield moved @ turn.T
