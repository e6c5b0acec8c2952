"""Law: a tree sways as slowly as its height wants, whatever the period that the model learned from."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamictree import method
from dynamictree.modal.real_trees import (
    LEAF_SLOWING,
    LEAST_BINS,
    height_law_hz,
    learned_law_hz,
    loop_period_s,
    natural_frequency_hz,
    speedup_of,
)
from dynamictree.models.motion_model import OnStep
from dynamictree.models.periods import LEARNED_FROM_M, PERIOD_S, period_by_height, spread_bins, with_period
from dynamictree.models.several_trees import generate_trees
from dynamictree.requests import PAPER_PERIOD_S, AnimateParams, ExportParams
from dynamictree.spectrum import NUM_FREQUENCIES, SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

SIDE = 16
LEAN_RAD = 0.05


def rod(height_m: float) -> SurfaceVoxels:
    """One stem of voxels."""
    coords = np.stack([np.full(SIDE, 8), np.full(SIDE, 8), np.arange(SIDE)], axis=1).astype(np.int32)
    grid = VoxelGrid(coords=coords, origin_m=(0.0, 0.0, 0.0), voxel_size_m=height_m / SIDE, resolution=SIDE)
    return SurfaceVoxels(grid=grid, normals=np.tile(np.float32([1, 0, 0]), (SIDE, 1)))


def simulated(frequency_hz: float, *, times: int = 1, bare: bool = False) -> np.ndarray:
    """|q_k| of a stem of this frequency in leaf, in a loop of `times` T and gusts of power 1 / k [rad]."""
    bins = np.arange(1, NUM_FREQUENCIES * times) / times
    ratio, damping = bins / (frequency_hz * PERIOD_S / (LEAF_SLOWING if bare else 1)), 0.039 if bare else 0.13
    return LEAN_RAD / np.sqrt(bins) / np.abs(1 - ratio**2 + 2j * damping * ratio)


def of_simulator(
    voxels: SurfaceVoxels, *, seed: int, lowest_bin: int = 1, on_step: OnStep | None = None, bare: bool = False
) -> SparseVoxelSpectrum:
    """A model that knows the simulator by heart, but bins not needed: a voxel moves by angle times height."""
    grid = voxels.grid
    height_m = (np.ptp(grid.coords[:, 2]) + 1) * grid.voxel_size_m
    coefficients = np.zeros((len(grid), NUM_FREQUENCIES, 3), np.complex64)
    coefficients[:, 1:, 0] = grid.centres_m[:, 2:] * simulated(float(learned_law_hz(height_m)), bare=bare)
    coefficients[:, 1:lowest_bin] = 1e6
    if on_step is not None:
        on_step(1, 1)
    return SparseVoxelSpectrum(grid=grid, coefficients=coefficients, seed=seed)


@pytest.mark.parametrize("bare", [False, True])
@pytest.mark.parametrize(("height_m", "times"), [(10.0, 2), (16.0, 3), (40.0, 4)])
def test_the_motion_is_that_of_the_simulator_with_the_longer_period(height_m: float, times: int, bare: bool) -> None:
    spectrum = with_period(partial(of_simulator, bare=bare), times * PERIOD_S)(rod(height_m), seed=0)
    moved = np.abs(spectrum.coefficients[-1, 1:NUM_FREQUENCIES, 0])
    wanted = simulated(float(height_law_hz(height_m)), times=times, bare=bare)
    truth = wanted[: NUM_FREQUENCIES - 1] * rod(height_m).grid.centres_m[-1, 2]
    # the gusts of a loop share one variance, so in a longer one each is weaker
    np.testing.assert_allclose(moved / moved.max(), truth / truth.max(), rtol=1e-4)


@pytest.mark.parametrize(("height_m", "quick_when_small"), [(9.0, True), (3.0, False)])
def test_the_period_of_the_model_gives_what_the_model_gives(height_m: float, quick_when_small: bool) -> None:
    spectrum = with_period(of_simulator, PERIOD_S, quick_when_small=quick_when_small)(rod(height_m), seed=0)
    np.testing.assert_array_equal(spectrum.coefficients, of_simulator(rod(height_m), seed=0).coefficients)
    assert pytest.approx(PERIOD_S) == PAPER_PERIOD_S


@given(st.floats(1, 60))
def test_the_lowest_frequency_has_two_bins_below(height_m: float) -> None:
    period_s = loop_period_s(height_m)
    assert PERIOD_S <= period_s <= 4 * PERIOD_S
    if height_m < 28.5:
        assert natural_frequency_hz(height_m, 0.5) * period_s >= LEAST_BINS
    assert period_by_height(rod(height_m)) == pytest.approx(period_s)


@given(st.floats(0.48, 7.2), st.integers(0, 5))
def test_bins_keep_their_power(longer: float, seed: int) -> None:
    matrix = spread_bins(longer, 1000, np.random.default_rng(seed))
    np.testing.assert_allclose((np.abs(matrix[:, 1:]) ** 2).sum(axis=0), 1, rtol=1e-5)
    rows, columns = np.nonzero(matrix)
    assert (np.abs(rows / longer - columns) <= max(0.5, 0.5 / longer) + 1e-9)[rows > 1].all()


@pytest.mark.parametrize("period_s", [2.0, 3.0, 6.25, 30.0])
def test_a_tree_in_any_period_keeps_its_size_and_its_frequency(period_s: float) -> None:
    as_it_is, spectrum = (
        with_period(of_simulator, period, quick_when_small=False)(rod(3.0), seed=0) for period in (PERIOD_S, period_s)
    )
    assert spectrum.period_s == pytest.approx(period_s, abs=0.5 / 24)
    size, frequency = zip(*(moments(one) for one in (as_it_is, spectrum)), strict=True)
    assert size[1] == pytest.approx(size[0], rel=1e-3)
    assert frequency[1] == pytest.approx(frequency[0], abs=0.25 / period_s)  # quarter of a bin's width


@pytest.mark.parametrize("period_s", [2.0, 3.0, PERIOD_S, 6.25, 30.0])
@pytest.mark.parametrize("height_m", [2.0, 3.0, 5.0, 5.9])  # taller ones choose a longer loop
def test_a_small_tree_is_faster_by_what_its_height_gives(height_m: float, period_s: float) -> None:
    size, frequency = zip(
        *(
            moments(with_period(of_simulator, period, quick_when_small=quick)(rod(height_m), seed=0))
            for period, quick in ((PERIOD_S, False), (period_s, True))
        ),
        strict=True,
    )
    bin_width = max(1 / period_s, speedup_of(height_m) / PERIOD_S)  # the spectrum's, or the model's times its speedup
    assert frequency[1] == pytest.approx(speedup_of(height_m) * frequency[0], abs=bin_width / 2)
    assert size[1] == pytest.approx(size[0], rel=0.02)  # less what is too fast for the bins


@pytest.mark.parametrize("height_m", [0.4, 0.7, 1.0, 1.5])
def test_a_tree_too_small_for_the_model_moves_as_a_larger_one_made_smaller(height_m: float) -> None:
    heights: list[float] = []

    def noted(voxels: SurfaceVoxels, **how: Any) -> SparseVoxelSpectrum:
        heights.append(voxels.grid.voxel_size_m * SIDE)
        return of_simulator(voxels, **how)

    spectrum = with_period(noted, PERIOD_S)(rod(height_m), seed=0)
    assert heights == pytest.approx([LEARNED_FROM_M])
    assert spectrum.grid.voxel_size_m == pytest.approx(height_m / SIDE)
    sizes = [np.sqrt(moments(one)[0]) / height_m for one in (of_simulator(rod(height_m), seed=0), spectrum)]
    assert sizes[1] == pytest.approx(sizes[0], rel=0.3)  # less what is too fast for the bins
    assert (np.abs(spectrum.coefficients[-1, 1:, 0]) > 0).all()


def test_the_grid_is_the_model_s() -> None:
    """A paper's model answers on its own grid, which may be coarser than that of the request."""
    coarse = rod(3.0)
    fine = SurfaceVoxels(
        grid=replace(coarse.grid, voxel_size_m=coarse.grid.voxel_size_m / 2, resolution=2 * SIDE),
        normals=coarse.normals,
    )
    paced = with_period(lambda voxels, **how: of_simulator(coarse, **how), 6.25, quick_when_small=False)
    assert paced(fine, seed=0).grid is coarse.grid


def test_trees_of_two_to_eight_metres_sway_at_the_pace_of_their_height() -> None:
    for height_m in np.linspace(2, 8, 9):
        quickened = learned_law_hz(float(height_m)) * speedup_of(float(height_m))
        assert quickened == pytest.approx(height_law_hz(float(height_m)))


def moments(spectrum: SparseVoxelSpectrum) -> tuple[float, float]:
    """Power of the tip, and its mean frequency [Hz]."""
    power = np.abs(spectrum.coefficients[-1, 1:, 0]) ** 2
    return float(power.sum()), float(power @ spectrum.frequencies_hz[1:] / power.sum())


def test_several_trees_share_the_period_of_the_tallest_and_sway_each_at_its_own_pace() -> None:
    short = rod(10.0)
    coords = np.concatenate([rod(20.0).grid.coords, short.grid.coords[: SIDE // 2] + np.int32([2, 0, 0])])
    grid = VoxelGrid(coords=coords, origin_m=(0.0, 0.0, 0.0), voxel_size_m=20 / SIDE, resolution=SIDE)
    tree = np.repeat(np.int32([0, 1]), [SIDE, SIDE // 2])
    both = SurfaceVoxels(grid=grid, normals=np.tile(np.float32([1, 0, 0]), (len(grid), 1)), tree=tree)
    period_s = period_by_height(both)
    assert period_s == pytest.approx(loop_period_s(20.0))
    spectrum = generate_trees(with_period(of_simulator, period_s), both, seed=0)
    fastest = [
        spectrum.frequencies_hz[1 + np.abs(spectrum.coefficients[row, 1:, 0]).argmax()] for row in (SIDE - 1, -1)
    ]
    assert fastest == pytest.approx([0.16, 0.24])  # 0.196 and 0.302 Hz in the simulator, in bins of 0.08 Hz


def test_a_number_of_frames_means_the_paper_s_period() -> None:
    assert ExportParams(num_frames=100).wanted_period_s == PAPER_PERIOD_S
    assert ExportParams(num_frames=100, loop=False).wanted_period_s is None
    assert ExportParams(num_frames=100, wind_mode="turbulent").wanted_period_s is None
    assert AnimateParams().wanted_period_s is None
    assert ExportParams().count_frames(loop_period_s(20.0)) == 300


def test_the_shipped_model_moves_a_tall_tree_slowly() -> None:
    spectrum = method.generate(rod_128(20.0), num_steps=1)
    energy = (np.abs(spectrum.coefficients) ** 2).sum(axis=(0, 2))
    assert spectrum.period_s == pytest.approx(12.5)
    assert spectrum.num_frequencies == 47
    assert spectrum.frequencies_hz[1 + np.argmax(energy[1:])] < 0.24


def rod_128(height_m: float) -> SurfaceVoxels:
    """A stem of 100 voxels in the grid that the models want."""
    coords = np.stack(np.meshgrid(np.arange(63, 65), np.arange(63, 65), np.arange(100), indexing="ij"), axis=-1)
    grid = VoxelGrid.from_coords(
        coords.reshape(-1, 3).astype(np.int32), origin_m=(0.0, 0.0, 0.0), voxel_size_m=height_m / 100, resolution=128
    )
    return SurfaceVoxels(grid=grid, normals=np.tile(np.float32([1, 0, 0]), (len(grid), 1)))
