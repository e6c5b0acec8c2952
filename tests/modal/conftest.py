import numpy as np
import pytest

from dynamictree.modal.system import ModalSystem, modal_system
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid
from tests.modal.trees import rigged_fork


def rod_spectrum(num_voxels: int = 40, num_frequencies: int = 16, *, seed: int = 1) -> SparseVoxelSpectrum:
    """A vertical rod, 4 m high, that leans and turns the more the higher; random phases a bin."""
    rng = np.random.default_rng(seed)
    coords = np.zeros((num_voxels, 3), np.int32)
    coords[:, 2] = np.arange(num_voxels)
    grid = VoxelGrid(coords=coords, origin_m=(0.0, 0.0, 0.0), voxel_size_m=4.0 / num_voxels, resolution=num_voxels)
    height = (np.arange(num_voxels) + 0.5) / num_voxels
    amplitude = 0.1 / (1 + np.arange(num_frequencies)) ** 1.5
    direction = rng.normal(size=(num_frequencies, 3)) + 1j * rng.normal(size=(num_frequencies, 3))
    direction[:, 2] *= 0.1
    coefficients = height[:, None, None] ** 2 * amplitude[:, None] * direction
    return SparseVoxelSpectrum(grid=grid, coefficients=coefficients.astype(np.complex64))


@pytest.fixture
def spectrum() -> SparseVoxelSpectrum:
    return rod_spectrum()


@pytest.fixture
def system(spectrum: SparseVoxelSpectrum) -> ModalSystem:
    return modal_system(spectrum, mass_kg=20.0, damping_ratio=0.05)


@pytest.fixture(scope="session")
def forked():
    tree, _, parts = rigged_fork(fineness=3)
    return tree, parts
