"""Laws of the gains by wind speed, and what the model's own are good for."""

import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamictree import method
from dynamictree.errors import FormatError, InputError
from dynamictree.formats.tensors.spectrum import read_spectrum, write_spectrum
from dynamictree.modal.turbulence import turbulent_wind
from dynamictree.models.motion_model import OnStep
from dynamictree.models.several_trees import with_bands
from dynamictree.models.small.amplitude import DRAG_EXPONENT
from dynamictree.requests import Wind
from dynamictree.spectrum import SparseVoxelSpectrum, mode_sizes
from dynamictree.wind_bands import BANDS_M_S, WindBands, bands_of_sizes, power_law
from lab.dataset.sample import make_sample
from tests.formats.meshes import written
from tests.formats.test_tensor_files import with_changes
from tests.modal.conftest import rod_spectrum

OWN_M_S = 5.0
TABLE = WindBands(speeds_m_s=(0.0, 1.0, 8.0, 20.0), gains=((0.0, 0.0), (0.1, 0.3), (2.0, 1.5), (5.0, 2.0)))


def rod_in(wind: Wind, on_step: OnStep | None = None) -> SparseVoxelSpectrum:
    """A rod whose bin k saturates at k + 1 times its size at 5 m/s."""
    if on_step is not None:
        on_step(1, 1)
    rod, most = rod_spectrum(), np.arange(1.0, 17)
    strength = most * np.tanh((wind.speed_m_s / OWN_M_S) ** 1.4 / most)
    return replace(rod, wind=wind, coefficients=(rod.coefficients * strength[:, None]).astype(np.complex64))


def test_gains_are_exact_at_each_speed() -> None:
    for speed, gains in zip(TABLE.speeds_m_s, TABLE.gains, strict=True):
        np.testing.assert_allclose(TABLE.at(speed), gains, rtol=1e-12)
    np.testing.assert_array_equal(TABLE.at(30.0), TABLE.gains[-1])


@given(speed=st.floats(0, 30), step=st.floats(0, 1e-3))
def test_gains_are_continuous_and_rise_where_the_table_rises(speed: float, step: float) -> None:
    change = TABLE.at(speed + step) - TABLE.at(speed)
    assert (change >= -1e-12).all()
    assert change.max() < 1e-3


@given(own=st.floats(0.5, 29), speed=st.floats(0, 30))
def test_without_bands_gains_are_those_of_the_drag(own: float, speed: float) -> None:
    of_speed, of_own = (u**1.4 if u < 12 else 12**0.4 * u for u in (speed, own))
    np.testing.assert_allclose(power_law(own, 3).at(speed), of_speed / of_own, rtol=1e-6, atol=1e-9)


def test_each_band_has_the_sizes_of_its_own_wind() -> None:
    steps: list[tuple[int, int]] = []
    spectrum = with_bands(rod_in, Wind(speed_m_s=OWN_M_S), lambda done, total: steps.append((done, total)))
    assert spectrum.bands.speeds_m_s == (0.0, 1.0, 4.0, 5.0, 8.0, 14.0, 20.0)
    np.testing.assert_array_equal(spectrum.coefficients, rod_in(Wind(speed_m_s=OWN_M_S)).coefficients)
    np.testing.assert_array_equal(spectrum.bands.at(OWN_M_S), 1)
    for speed in BANDS_M_S.values():
        there = mode_sizes(rod_in(Wind(speed_m_s=speed)).coefficients)
        np.testing.assert_allclose(mode_sizes(spectrum.coefficients) * spectrum.bands.at(speed), there, rtol=1e-5)
    assert steps == [(number, 6) for number in range(1, 7)]

    steps.clear()  # a wind that is a band is asked for once
    with_bands(rod_in, Wind(speed_m_s=8.0), lambda done, total: steps.append((done, total)))
    assert steps == [(number, 5) for number in range(1, 6)]


@pytest.mark.slow
def test_the_models_storm_is_weaker_than_the_drag_of_its_training() -> None:
    voxels = method.voxelize(make_sample(3, "sapling").mesh)
    bands = method.generate(voxels, wind=Wind(speed_m_s=OWN_M_S), num_steps=1, wind_bands=True).wind_bands
    ratio = bands.at(BANDS_M_S["storm"]) / (BANDS_M_S["storm"] / OWN_M_S) ** DRAG_EXPONENT
    assert ratio.max() < 1.1
    assert ratio.mean() < 0.9


def test_a_file_gives_the_bands_back() -> None:
    spectrum = with_bands(rod_in, Wind(speed_m_s=OWN_M_S))
    content = written(write_spectrum, spectrum)
    assert read_spectrum(io.BytesIO(content)).bands == spectrum.bands
    for tensors in (
        {"band_gains": None},
        {"band_gains": np.full((7, 16), -1, np.float32)},
        {"band_speeds_m_s": np.zeros(7, np.float32)},
    ):
        with pytest.raises((FormatError, InputError), match=r"band"):
            read_spectrum(io.BytesIO(with_changes(content, tensors, {})))


def test_bands_of_other_bins_are_refused() -> None:
    with pytest.raises(InputError, match="2 frequencies, the spectrum 16"):
        replace(rod_spectrum(), bands=TABLE)


def test_a_motion_of_no_wind_has_bands_too() -> None:
    bands = bands_of_sizes({0.0: np.array([0.0, 1e-3]), 4.0: np.array([0.1, 2e-3])}, 0.0)
    assert bands.at(0.0).max() == 0
    np.testing.assert_allclose(bands.at(4.0), [1.0, 2.0], rtol=1e-6)


def test_endless_wind_is_as_much_stronger_in_another_wind() -> None:
    steps = np.linspace(0.5, 2, 16)
    bands = bands_of_sizes({5.0: np.ones(16), 20.0: steps}, OWN_M_S)
    spectrum = replace(rod_spectrum(), wind=Wind(speed_m_s=OWN_M_S), bands=bands)
    times = np.linspace(0, 50, 200)
    winds = (turbulent_wind(spectrum, seed=1, wind=Wind(speed_m_s=speed, gust=0.0)) for speed in (OWN_M_S, 20.0))
    own, storm = (np.abs(wind.coordinates(times)).mean(axis=0) for wind in winds)
    np.testing.assert_allclose(storm / own, steps, rtol=0.01)
