"""Gusts that travel through a crown: what moves beside the trunk is delayed by its distance downwind.

Phases of the small model do not depend on the position along the wind, so its gusts arrive everywhere at once. Air
carries turbulence past a tree unchanged (Taylor), and each branch answers to the air at its place.
"""

import numpy as np
from jaxtyping import Float32

from dynamictree.models.wind import REFERENCE_SPEED, wind_axes
from dynamictree.parallel import single_thread
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.grid import VoxelGrid


def delay_downwind(spectrum: SparseVoxelSpectrum, wind: Wind) -> SparseVoxelSpectrum:
    """Delay, in place, all but the trunk's bending by the distance downwind of the tree's middle, over the speed.

    What is still stays so. Below REFERENCE_SPEED the delay grows no further: it would distort branches, which answer
    as a whole. Crowns of the simulator have half of the air's delay at 8 m/s, a fifth at 4 and a sixteenth at 2.
    """
    most_rows, voxels_at_once = 5_000, 65_536  # rows to fit the trunk to
    grid, moving = spectrum.grid, spectrum.coefficients[:, 1:]
    omega = 2 * np.pi * spectrum.frequencies_hz[1:] / max(wind.speed_m_s, REFERENCE_SPEED)  # [rad/m]
    downwind_m = (grid.centres_m - grid.centres_m.mean(axis=0)) @ wind_axes(wind)[0]
    shapes = _trunk_shapes(grid)
    some = slice(None, None, -(-len(grid) // most_rows))
    with single_thread():  # so that the result does not depend on the number of threads
        bends = [np.linalg.lstsq(shape[some], moving[some, :, i], rcond=None)[0] for i, shape in enumerate(shapes)]
    for start in range(0, len(grid), voxels_at_once):
        rows = slice(start, start + voxels_at_once)
        turn = np.exp(-1j * np.outer(downwind_m[rows], omega).astype(np.float32)) - 1
        turn[~moving[rows].any(axis=(1, 2))] = 0
        for axis, (shape, bend) in enumerate(zip(shapes, bends, strict=True)):
            moving[rows, :, axis] += (moving[rows, :, axis] - shape[rows] @ bend.astype(np.complex64)) * turn
    return spectrum


def _trunk_shapes(grid: VoxelGrid) -> tuple[Float32[np.ndarray, "V S"], ...]:
    """Return the displacements along x, y and z of a tree whose trunk bends as z² and z³, and tilts its crown so."""
    x, y, z = ((grid.centres_m - grid.centres_m.mean(axis=0)) / grid.height_m).T
    z = z - z.min()
    level = np.stack([z**2, z**3], axis=1)
    return level, level, np.stack([*level.T, x * z, y * z, x * z**2, y * z**2], axis=1)
