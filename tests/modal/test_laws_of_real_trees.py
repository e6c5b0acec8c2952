"""Natural frequencies and damping agree with measurements of real trees."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.modal.force import Drag, contact_at_voxel
from dynamictree.modal.real_trees import free_omega, natural_damping, natural_frequency_hz
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.system import modal_system, with_physics
from dynamictree.spectrum import SparseVoxelSpectrum

# height class [m], 10th and 90th percentile [Hz]; of models of scanned trees to 12 m, then of measured broadleaves
BANDS = [
    ((4, 8), 0.26, 1.24),
    ((8, 12), 0.21, 0.55),
    ((16, 20), 0.167, 0.242),
    ((20, 25), 0.125, 0.218),
    ((25, 56), 0.111, 0.210),
]
DT_S = 1 / 60


def scaled(spectrum: SparseVoxelSpectrum, height_m: float) -> SparseVoxelSpectrum:
    """The same tree at another height."""
    grid = spectrum.grid
    factor = height_m / ((np.ptp(grid.coords[:, 2]) + 1) * grid.voxel_size_m)
    larger = replace(grid, origin_m=tuple(factor * x for x in grid.origin_m), voxel_size_m=factor * grid.voxel_size_m)
    return SparseVoxelSpectrum(grid=larger, coefficients=(factor * spectrum.coefficients).astype(np.complex64))


@pytest.mark.parametrize(("heights", "low", "high"), BANDS)
@pytest.mark.parametrize("foliage", [0.0, 1.0])
def test_the_lowest_frequency_lies_in_the_measured_band(
    heights: tuple[float, float], low: float, high: float, foliage: float
) -> None:
    for height_m in np.linspace(*heights, 5):
        assert low <= natural_frequency_hz(float(height_m), foliage) <= high, height_m


def test_trees_in_leaf_are_slower_and_more_damped() -> None:
    assert 0.79 <= natural_frequency_hz(15.0, 1.0) / natural_frequency_hz(15.0, 0.0) <= 0.94
    assert natural_damping(0.0) == pytest.approx(0.039)
    assert natural_damping(1.0) == pytest.approx(0.13)
    assert 0.039 < natural_damping(0.5) < 0.13


def test_modes_below_the_lowest_frequency_ring_at_it_and_high_ones_hardly_change() -> None:
    bins = 2 * np.pi * np.arange(1, 16) / 4.17
    np.testing.assert_allclose(free_omega(bins, 1 / 4.17), bins)
    free = free_omega(bins, 0.9)
    assert free[0] == pytest.approx(2 * np.pi * 0.9)
    assert (np.diff(free) > 0).all()
    assert free[-1] / bins[-1] < 1.04
    assert (np.diff(free_omega(bins, 0.05)) > 0).all()  # a tree that is slower than the first bin


@pytest.mark.parametrize("height_m", [3.0, 6.0, 10.0, 14.0, 22.0, 35.0])
def test_a_released_pull_rings_at_the_trees_own_frequency_and_damping(
    spectrum: SparseVoxelSpectrum, height_m: float
) -> None:
    system = modal_system(scaled(spectrum, height_m))
    top = int(system.grid.coords[:, 2].argmax())
    at = contact_at_voxel(system.grid, top)
    pull = Drag(at=at, force_n=(1.0, 0.0, 0.0), duration_s=2 * DT_S)
    answer = respond(system, group_forces([pull], falloff_m=None), dt_s=DT_S, num_frames=60 * 240, start="held")
    x = (answer.q[2:, 0] @ system.shapes[top, :, 0]).real
    power = np.abs(np.fft.rfft(x)) ** 2
    peak_hz = np.fft.rfftfreq(len(x), DT_S)[1:][power[1:].argmax()]
    wanted = natural_frequency_hz(height_m, system.foliage)
    assert peak_hz == pytest.approx(wanted, rel=0.1)
    assert np.allclose(system.damping_ratio, natural_damping(system.foliage))


def test_a_request_says_the_foliage_then_the_spectrum_else_it_lies_in_between(spectrum: SparseVoxelSpectrum) -> None:
    in_leaf = modal_system(replace(spectrum, foliage=1.0))
    assert (in_leaf.damping_ratio == natural_damping(1.0)).all()
    bare = with_physics(in_leaf, foliage=0.0)
    assert (bare.damping_ratio == natural_damping(0.0)).all()
    assert bare.omega[0] > in_leaf.omega[0]
    assert (modal_system(replace(spectrum, foliage=1.0), foliage=0.0).damping_ratio == bare.damping_ratio).all()
    unknown = modal_system(replace(spectrum, foliage=None))
    assert unknown.foliage is None
    assert unknown.damping_ratio == pytest.approx(0.08, abs=0.001)
    assert in_leaf.omega[0] < unknown.omega[0] < bare.omega[0]
    with pytest.raises(InputError, match=r"foliage is 1\.5; 0"):
        replace(spectrum, foliage=1.5)


def test_given_physics_replace_the_measured_ones(spectrum: SparseVoxelSpectrum) -> None:
    system = modal_system(spectrum, damping_ratio=0.2, frequency_hz=0.5)
    assert system.omega[0] == pytest.approx(np.pi)
    assert (system.damping_ratio == 0.2).all()
    measured = with_physics(system)
    assert measured.omega[0] == pytest.approx(2 * np.pi * natural_frequency_hz(system.height_m, system.foliage))
    np.testing.assert_allclose(with_physics(system, frequency_hz=0.7).omega[0], 2 * np.pi * 0.7)


@pytest.mark.parametrize("frequency_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_frequencies_are_refused(spectrum: SparseVoxelSpectrum, frequency_hz: float) -> None:
    with pytest.raises(InputError, match="frequency_hz"):
        modal_system(spectrum, frequency_hz=frequency_hz)
