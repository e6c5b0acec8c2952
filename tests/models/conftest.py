import numpy as np
import pytest

from dynamictree.models.small.features import TreeFeatures, tree_features
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.moments import AREA, OFFSET, moments_of_normals
from dynamictree.voxel.voxelize import SurfaceVoxels


def line(start: tuple[float, float, float], end: tuple[float, float, float]) -> np.ndarray:
    count = int(3 * max(abs(b - a) for a, b in zip(start, end, strict=True))) + 1
    return np.linspace(start, end, count).round().astype(np.int32)


@pytest.fixture(scope="session")
def fork() -> VoxelGrid:
    """A trunk of 60 voxels that stands at (64, 64), and two branches, one long and one short."""
    coords = [line((64, 64, 1), (64, 64, 60)), line((64, 64, 40), (30, 64, 90)), line((64, 64, 50), (64, 80, 70))]
    return VoxelGrid.from_coords(np.concatenate(coords), origin_m=(-6.4, -6.4, 0.0), voxel_size_m=0.1, resolution=128)


@pytest.fixture(scope="session")
def voxels(fork: VoxelGrid) -> SurfaceVoxels:
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((len(fork), 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    moments = moments_of_normals(normals[rng.permutation(len(fork))])
    moments[:, AREA] = rng.uniform(0.1, 2, (len(fork), 1))
    moments[:, OFFSET] = rng.uniform(-0.4, 0.4, (len(fork), 3))
    return SurfaceVoxels(grid=fork, normals=normals, moments=moments)


@pytest.fixture(scope="session")
def tree(voxels: SurfaceVoxels) -> TreeFeatures:
    return tree_features(voxels)
