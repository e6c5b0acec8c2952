"""Baselines that a model has to beat; each returns a spectrum [V, K, 3] in metres for a held-out tree."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float64, Int32

from dynamictree.models.wind import wind_axes
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from lab.dataset.sample import make_sample, voxel_spectrum

NUM_BINS = 20  # bins over the height
FLOOR = 1e-6  # share of the tree's height, added before a logarithm


@dataclass(frozen=True, kw_only=True)
class TrainingTree:
    """A training tree in the form that the baselines use."""

    coords: Int32[np.ndarray, "V 3"]
    spectrum: Complex64[np.ndarray, "V K 3"]  # over the tree's height, in the wind's frame


def training_tree(seed: int, resolution: int = 128) -> TrainingTree:
    """Generate the dataset's tree of a seed."""
    sample = make_sample(seed)
    voxels, spectrum = voxel_spectrum(sample, resolution)
    turned = spectrum.coefficients @ wind_axes(sample.wind).T / voxels.grid.height_m
    return TrainingTree(coords=voxels.grid.coords, spectrum=turned.astype(np.complex64))


@dataclass(frozen=True, kw_only=True)
class ByHeight:
    """Geometric mean of |c| over the training trees, by height above the ground."""

    log_size: Float64[np.ndarray, "H J 3"]  # over the tree's height, in the wind's frame
    lean: Float64[np.ndarray, "H 3"]

    def spectrum(self, grid: VoxelGrid, wind: Wind, rng: np.random.Generator) -> Complex64[np.ndarray, "V K 3"]:
        """Return the mean spectrum with one random phase per frequency and axis."""
        above = grid.coords[:, 2] - grid.coords[:, 2].min()
        height_m = (above.max() + 1) * grid.voxel_size_m
        place = (above + 0.5) / (above.max() + 1) * NUM_BINS - 0.5
        low = np.clip(np.floor(place).astype(int), 0, NUM_BINS - 2)
        share = np.clip(place - low, 0, 1)[:, None, None]
        log_size = (1 - share) * self.log_size[low] + share * self.log_size[low + 1]
        lean = (1 - share[:, 0]) * self.lean[low] + share[:, 0] * self.lean[low + 1]
        phases = np.exp(2j * np.pi * rng.random((log_size.shape[1], 3))).astype(np.complex64)
        relative = np.concatenate([lean[:, None], np.exp(log_size) * phases], axis=1)
        return np.asarray(relative @ wind_axes(wind) * height_m, np.complex64)


def fit_by_height(trees: Sequence[TrainingTree]) -> ByHeight:
    """Average the training trees."""
    num_frequencies = trees[0].spectrum.shape[1]
    total = np.zeros((NUM_BINS, num_frequencies, 3))
    count = np.zeros(NUM_BINS)
    for one in trees:
        above = one.coords[:, 2] - one.coords[:, 2].min()
        place = (above * NUM_BINS // (above.max() + 1)).astype(int)
        values = np.log(np.abs(one.spectrum).astype(np.float64) + FLOOR)
        values[:, 0] = one.spectrum[:, 0].real
        np.add.at(total, place, values)
        count += np.bincount(place, minlength=NUM_BINS)
    mean = total / np.maximum(count, 1)[:, None, None]
    return ByHeight(log_size=mean[:, 1:], lean=mean[:, 0])
