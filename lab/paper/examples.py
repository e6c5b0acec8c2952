"""Training examples of the paper's network: voxels, normals and spectra of one tree, cached on disk.

A spectrum is stored over the tree's height, in the wind's frame, and divided by the known effect of speed and gust
(`models.wind`): unlike the paper's trees, ours are in different winds.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Int64
from safetensors.torch import load_file, save_file
from scipy.spatial import cKDTree
from torch import Tensor

from dynamictree.errors import InputError
from dynamictree.models.paper.network import PaperInputs, PaperPreset, unit_positions
from dynamictree.models.wind import wind_axes, wind_sizes
from dynamictree.sparse.level import batch_pyramids, pyramid
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import voxelize
from lab.dataset.shards import StoredTree, iter_shard
from lab.training.loss import LocalSmoothness, nearest_voxels

RESOLUTION = 128  # resolution of the voxels and spectra in the shards
HALF_SCALE = 1000.0
"""Spectra over the height are 1e-5 to 0.1; multiplied by this factor they suit float16."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PaperExample:
    """Voxels of one tree, and its spectrum on the encoder's output grid."""

    coords: Int64[Tensor, "X 3"]  # voxels of the encoder's finest grid
    normals: Float32[Tensor, "X 3"]
    resolution: int  # resolution of that grid
    voxel_size_m: float  # voxel size of the spectrum's grid
    spectrum: Complex64[Tensor, "V K 3"]  # rows in ascending order of coordinates


@dataclass(frozen=True, kw_only=True, eq=False)
class PaperBatch:
    """Batch of trees as the network's input."""

    inputs: PaperInputs
    spectrum: Complex64[Tensor, "V K 3"]
    neighbours: Int64[Tensor, "V M"]  # indices of the nearest voxels
    distances_m: Float32[Tensor, "V M"]


def batch_of(examples: Sequence[PaperExample], preset: PaperPreset) -> PaperBatch:
    """Build the pyramids and neighbourhoods of some trees."""
    grids, rows, distances, start = [], [], [], 0
    for one in examples:
        own = pyramid(one.coords, preset.num_levels)
        centres = own.levels[preset.num_halvings].coords.numpy().astype(np.float32) * one.voxel_size_m
        nearest, far = nearest_voxels(centres, LocalSmoothness().num_neighbours)
        rows.append(nearest + start)
        distances.append(far)
        grids.append(own)
        start += len(centres)
    return PaperBatch(
        inputs=PaperInputs(
            positions=torch.cat([unit_positions(one.coords, one.resolution) for one in examples]),
            normals=torch.cat([one.normals for one in examples]),
            grids=batch_pyramids(grids),
        ),
        spectrum=torch.cat([one.spectrum for one in examples]),
        neighbours=torch.cat(rows),
        distances_m=torch.cat(distances),
    )


def paper_example(stored: StoredTree, preset: PaperPreset) -> PaperExample:
    """Convert a shard's tree to the preset's grids; voxelize its mesh if the shard lacks the fine grid.

    Raises:
        InputError: the preset's resolution does not divide the stored one.
    """
    factor = RESOLUTION // preset.resolution
    if factor * preset.resolution != RESOLUTION:
        raise InputError(f"the resolution is {preset.resolution}; it must be {RESOLUTION} divided by a power of two")
    if preset.condition_resolution in stored.grids:
        fine = stored.voxels(preset.condition_resolution)
    else:
        fine = voxelize(stored.mesh(), preset.condition_resolution)
    coords = np.unique(fine.grid.coords >> preset.num_halvings, axis=0).astype(np.int32)
    height_m = float(np.ptp(stored.tensors["vertices"][:, 2]))
    relative = _pooled(stored, coords, preset) @ wind_axes(stored.wind).T / height_m
    relative /= wind_sizes(stored.wind, preset.num_frequencies)[:, None]
    return PaperExample(
        coords=torch.from_numpy(fine.grid.coords.astype(np.int64)),
        normals=torch.from_numpy(fine.normals),
        resolution=preset.condition_resolution,
        voxel_size_m=fine.grid.voxel_size_m * (1 << preset.num_halvings),
        spectrum=torch.from_numpy(relative.astype(np.complex64)),
    )


def _pooled(stored: StoredTree, coords: np.ndarray, preset: PaperPreset) -> Complex64[np.ndarray, "V K 3"]:
    """Average the stored spectrum over each coarser voxel, in the order of `coords`; if empty, take the nearest."""
    factor, spectrum = RESOLUTION // preset.resolution, stored.spectrum(RESOLUTION)
    coarse = VoxelGrid.from_coords(
        spectrum.grid.coords // factor,
        origin_m=spectrum.grid.origin_m,
        voxel_size_m=spectrum.grid.voxel_size_m * factor,
        resolution=preset.resolution,
    )
    owner = coarse.rows_of(spectrum.grid.coords // factor)
    coefficients = spectrum.coefficients[:, : preset.num_frequencies]
    total = np.zeros((len(coarse), *coefficients.shape[1:]), np.complex64)
    np.add.at(total, owner, coefficients)
    mean = total / np.bincount(owner, minlength=len(coarse))[:, None, None]
    _, nearest = cKDTree(coarse.coords).query(coords)
    return np.asarray(mean[nearest], np.complex64)


class ExampleCache(torch.utils.data.Dataset[PaperExample]):
    """The training trees of shards, prepared once and read from disk afterwards."""

    def __init__(self, shards: Sequence[str], preset: PaperPreset, folder: Path) -> None:
        """Prepare missing examples in `folder`, which is created if needed.

        Raises:
            InputError: the shards have no trees for training.
        """
        grids = preset.resolution, preset.num_halvings, preset.num_frequencies
        identity = json.dumps([grids, *map(_fingerprint, shards)])
        self.folder = folder / hashlib.sha256(identity.encode()).hexdigest()[:16]
        self.folder.mkdir(parents=True, exist_ok=True)
        complete = self.folder / "complete"
        if not complete.exists():
            trees = (tree for path in shards for tree in iter_shard(path) if tree.split == "train")
            for number, stored in enumerate(trees):
                path = self._path(number)
                if not path.exists():
                    _write_example(paper_example(stored, preset), path)
            complete.touch()
        self.count = len(list(self.folder.glob("*.safetensors")))
        if not self.count:
            raise InputError("the shards hold no trees for training; bake some with `dynamictree dataset generate`")

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> PaperExample:
        return _read_example(self._path(index))

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:06d}.safetensors"


def _fingerprint(shard: str) -> list[object]:
    facts = Path(shard).stat()
    return [Path(shard).name, facts.st_size, facts.st_mtime_ns]


def _write_example(example: PaperExample, path: Path) -> None:
    partial = path.with_suffix(".partial")
    tensors = {
        "coords": example.coords.short(),
        "normals": example.normals.half(),
        "spectrum": torch.view_as_real(example.spectrum * HALF_SCALE).half(),
        "grid": torch.tensor([example.resolution, example.voxel_size_m], dtype=torch.float64),
    }
    save_file({name: value.contiguous() for name, value in tensors.items()}, partial)
    partial.rename(path)


def _read_example(path: Path) -> PaperExample:
    tensors = load_file(path)
    resolution, voxel_size_m = tensors["grid"].tolist()
    return PaperExample(
        coords=tensors["coords"].long(),
        normals=tensors["normals"].float(),
        resolution=int(resolution),
        voxel_size_m=voxel_size_m,
        spectrum=torch.view_as_complex(tensors["spectrum"].float() / HALF_SCALE),
    )
