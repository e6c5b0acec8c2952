"""Gusts travel through the crowns of the small model, and the trunk moves as before."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.gust_fronts import gust_lag
from dynamictree import method
from dynamictree.models import load_model
from dynamictree.models.gust_travel import delay_downwind
from dynamictree.spectrum import SparseVoxelSpectrum, Wind, to_motion
from dynamictree.voxel.grid import VoxelGrid
from lab.dataset.sample import make_sample
from lab.evaluation.motion_statistics import without_trunk_motion


@pytest.mark.parametrize(("speed_m_s", "carried_m_s"), [(2.0, 5.0), (5.0, 5.0), (12.0, 12.0)])
def test_all_but_a_bending_trunk_is_late_by_its_way_downwind(
    speed_m_s: float, carried_m_s: float, rng: np.random.Generator
) -> None:
    coords = np.unique(rng.integers(0, 64, (4000, 3)), axis=0).astype(np.int32)
    grid = VoxelGrid.from_coords(coords, origin_m=(-3.0, 5.0, 0.0), voxel_size_m=0.1, resolution=64)
    x, y, z = ((grid.centres_m - grid.centres_m.mean(axis=0)) / grid.height_m).T
    z = z - z.min()
    bend = np.stack([z**2, 2 * z**3, y * z**2 - x * z], axis=1)[:, None] * (1 + 0.5j) * np.ones((1, 16, 1))
    own = rng.choice([-1.0, 1.0], len(grid))[:, None, None] * np.ones((1, 16, 3))  # adds up to hardly a bend
    wind = Wind(speed_m_s=speed_m_s, direction_deg=90.0)
    bend[:9] = own[:9] = 0
    before = SparseVoxelSpectrum(grid=grid, coefficients=(bend + own).astype(np.complex64), wind=wind)
    after = delay_downwind(replace(before, coefficients=before.coefficients.copy()), wind)
    late = np.exp(-2j * np.pi * before.frequencies_hz * y[:, None] * grid.height_m / carried_m_s)
    error = after.coefficients - bend - own * late[:, :, None]
    assert np.sqrt((np.abs(error) ** 2).mean()) < 0.1
    assert not after.coefficients[:9].any()
    np.testing.assert_array_equal(after.coefficients[:, 0], before.coefficients[:, 0])


def test_gusts_run_through_a_generated_crown_along_the_wind() -> None:
    mesh = make_sample(3, "sapling").mesh
    voxels = method.voxelize(replace(mesh, vertices=4 * mesh.vertices))
    wind = Wind(speed_m_s=8.0, gust=0.3, direction_deg=90.0)
    at_once = load_model("small").generate(voxels, wind=wind, seed=0)
    travelling = method.generate(voxels, wind=wind, seed=0, period_s=at_once.period_s)
    crosswind, downwind = (np.array([_lag(one, axis) for one in (at_once, travelling)]) for axis in (0, 1))
    assert np.ptp(crosswind) * wind.speed_m_s < 0.3
    assert 0.6 < (downwind[1] - downwind[0]) * wind.speed_m_s < 1.4


def _lag(spectrum: SparseVoxelSpectrum, axis: int) -> float:
    """The delay of gusts along an axis, beside the trunk [s/m]."""
    moving = spectrum.coefficients.copy()
    moving[:, 0] = 0
    motion = to_motion(moving, spectrum.num_frames).astype(np.float64)
    return gust_lag(
        spectrum.grid.centres_m[:, axis], without_trunk_motion(spectrum.grid.centres_m, motion), spectrum.period_s
    )
