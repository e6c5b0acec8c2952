"""Small clouds of Gaussians."""

from dataclasses import replace

import numpy as np

from dynamictree.gaussian.binding import Binding, Leaves
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.rig.flutter import Flutter, sample_flutter
from dynamictree.rotation import unit_quaternions
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.grid import VoxelGrid


def cloud_at(
    means: np.ndarray, *, turned: object = (1, 0, 0, 0), scale: object = 0.02, opacity: object = 0.9, sh: object = None
) -> GaussianCloud:
    """Gaussians at these places; any other value may be the same for all."""

    def rows(values: object, *width: int) -> np.ndarray:
        return np.array(np.broadcast_to(np.asarray(values, np.float32), (len(means), *width)), order="C")

    return GaussianCloud(
        means=np.asarray(means, np.float32),
        quaternions=unit_quaternions(rows(turned, 4)),
        scales=rows(scale, 3),
        opacity=rows(opacity),
        sh=rows(0, 1, 3) if sh is None else np.asarray(sh, np.float32),
    )


def still_spectrum(num_frames: int = 100) -> SparseVoxelSpectrum:
    """One voxel that does not move, of a tree in leaf in a storm of 30 m/s."""
    grid = VoxelGrid(coords=np.zeros((1, 3), np.int32), resolution=8, origin_m=(0.0, 0.0, 0.0), voxel_size_m=1.0)
    nothing, storm = np.zeros((1, 1, 3), np.complex64), Wind(speed_m_s=30.0)
    return SparseVoxelSpectrum(grid=grid, coefficients=nothing, num_frames=num_frames, wind=storm, foliage=1.0)


def with_two_leaves(binding: Binding, num_frames: int) -> tuple[Binding, Flutter]:
    """Of three Gaussians one in each of two leaves, which flutter in a storm about two vertices."""
    leaf_of = np.where(binding.moving, np.arange(binding.cloud.num_gaussians) % 3 - 1, -1).astype(np.int32)
    across = np.eye(3, dtype=np.float32)[:2]
    flutter = sample_flutter(across, np.full(2, 0.2), np.ones(2, int), np.ones(2), still_spectrum(num_frames))
    return replace(binding, leaves=Leaves(of=leaf_of, vertex=binding.triangles[[0, -1], [1, 2]])), flutter
