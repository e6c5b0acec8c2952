"""Several trees in one grid: each is generated separately, with its own root and seed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Int64

from dynamictree.models.motion_model import OnStep
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.voxelize import SurfaceVoxels

RESOLUTIONS = (128, 256, 512)


def generate_trees(
    generate: Callable[..., SparseVoxelSpectrum], voxels: SurfaceVoxels, *, seed: int, on_step: OnStep | None = None
) -> SparseVoxelSpectrum:
    """Generate the spectrum of one motion of one tree or of several.

    Tree n of several gets the seed `seed` + n. What a tree is given does not depend on the others.

    Args:
        generate: `MotionModel.generate` of a model, with wind and number of steps.
        voxels: of all trees.
        seed: of the first tree.
        on_step: see OnStep; steps are counted over all trees.
    """
    if voxels.tree is None:
        return generate(voxels, seed=seed, on_step=on_step)
    numbers = np.unique(voxels.tree).tolist()
    spectra = []
    for index, number in enumerate(numbers):
        rows = np.flatnonzero(voxels.tree == number)
        own_steps = share_of_steps(on_step, index, len(numbers))
        spectrum = generate(tree_voxels(voxels, rows), seed=seed + int(number), on_step=own_steps)
        spectra.append((rows, spectrum.coefficients))
    coefficients = np.zeros((len(voxels.grid), *spectra[0][1].shape[1:]), np.complex64)
    for rows, of_tree in spectra:
        coefficients[rows] = of_tree
    return replace(spectrum, grid=voxels.grid, coefficients=coefficients, tree=voxels.tree, seed=seed)


def tree_voxels(voxels: SurfaceVoxels, rows: Int64[np.ndarray, " M"]) -> SurfaceVoxels:
    """Move some voxels to the smallest sufficient grid: centred, on its floor."""
    coords = voxels.grid.coords[rows]
    low, extent = coords.min(axis=0), np.ptp(coords, axis=0) + 1
    resolution = next(size for size in RESOLUTIONS if size >= extent.max())
    start = low - np.array([*(resolution - extent[:2]) // 2, 0])
    origin = np.asarray(voxels.grid.origin_m) + start * voxels.grid.voxel_size_m
    return SurfaceVoxels(
        grid=replace(
            voxels.grid,
            coords=(coords - start).astype(np.int32),
            origin_m=(float(origin[0]), float(origin[1]), float(origin[2])),
            resolution=resolution,
        ),
        normals=voxels.normals[rows],
        moments=None if voxels.moments is None else voxels.moments[rows],
    )


def share_of_steps(on_step: OnStep | None, index: int, count: int) -> OnStep | None:
    """What one of `count` runs reports its steps to, so that they are counted over all."""
    if on_step is None:
        return None
    return lambda done, total: on_step(index * total + done, count * total)
