"""Split the voxels of several trees, generate each tree by itself, and join the spectra."""

from dataclasses import replace

import numpy as np
from jaxtyping import Int64

from dynamictree.models.motion_model import Generate, OnStep
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

RESOLUTIONS = (128, 256, 512)


def generate_trees(
    generate: Generate, voxels: SurfaceVoxels, *, seed: int, on_step: OnStep | None = None
) -> SparseVoxelSpectrum:
    """Generate the spectrum of one motion of one tree or of several.

    Tree n of several gets the seed `seed` + n. What a tree is given does not depend on the others.

    Args:
        generate: gives the spectrum of one tree; all in the same period, each with as many frequencies as it needs.
        voxels: of all trees.
        seed: of the first tree.
        on_step: see OnStep; steps are counted over all trees.
    """
    if voxels.tree is None:
        return generate(voxels, seed=seed, on_step=on_step)
    rows_of_tree = {int(number): np.flatnonzero(voxels.tree == number) for number in np.unique(voxels.tree)}
    spectra = []
    for index, (number, rows) in enumerate(rows_of_tree.items()):
        own, own_steps = tree_voxels(voxels, rows), share_of_steps(on_step, index, len(rows_of_tree))
        spectra.append(_on_grid(generate(own, seed=seed + number, on_step=own_steps), own.grid))
    num_frequencies = max(spectrum.num_frequencies for spectrum in spectra)
    coefficients = np.zeros((len(voxels.grid), num_frequencies, 3), np.complex64)
    for rows, spectrum in zip(rows_of_tree.values(), spectra, strict=True):
        coefficients[rows, : spectrum.num_frequencies] = spectrum.coefficients
    foliage = [spectrum.foliage for spectrum in spectra]
    stated = [one for one in foliage if one is not None]
    return replace(
        spectra[0],
        grid=voxels.grid,
        coefficients=coefficients,
        tree=voxels.tree,
        seed=seed,
        foliage=float(np.mean(stated)) if stated else None,
    )


def _on_grid(spectrum: SparseVoxelSpectrum, grid: VoxelGrid) -> SparseVoxelSpectrum:
    """A spectrum that may be on a coarser grid than its tree: each voxel gets that of the one around it."""
    coarser = grid.resolution // spectrum.grid.resolution
    if coarser == 1:
        return spectrum
    return replace(
        spectrum, grid=grid, coefficients=spectrum.coefficients[spectrum.grid.rows_of(grid.coords // coarser)]
    )


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
