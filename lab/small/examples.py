"""Training examples of the small model, made from the dataset's trees."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import torch
from jaxtyping import Complex64
from torch import Tensor

from dynamictree.errors import InputError
from dynamictree.models.small.features import TreeFeatures, tree_features
from dynamictree.models.wind import wind_axes
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.voxelize import SurfaceVoxels, surface_moments
from lab.dataset.sample import make_sample, voxel_spectrum
from lab.dataset.shards import StoredTree, iter_shard


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """One tree, its wind, and its motion as a share of its height in the wind's frame."""

    tree: TreeFeatures
    wind: Wind
    spectrum: Complex64[Tensor, "V K 3"]


def iter_training(paths: Sequence[str], *, first: int, count: int) -> Iterator[StoredTree]:
    """Iterate over `count` training trees from number `first` on, in the shards' order; skip held-out trees.

    Raises:
        InputError: the shards have fewer.
    """
    trees = (tree for path in paths for tree in iter_shard(path) if tree.split == "train")
    taken = 0
    for tree in islice(trees, first, first + count):
        taken += 1
        yield tree
    if taken < count:
        raise InputError(
            f"the shards hold {first + taken} trees for training; {first + count} are needed: "
            "bake more with `dynamictree dataset generate`, or ask for fewer"
        )


def example_of(stored: StoredTree, resolution: int = 128, *, with_mesh: bool = True) -> Example:
    """Convert a tree of a shard; `with_mesh=False` treats it as voxels without moments."""
    voxels = voxels_of(stored, resolution) if with_mesh else stored.voxels(resolution)
    return _example(voxels, stored.wind, stored.spectrum(resolution))


def voxels_of(stored: StoredTree, resolution: int = 128) -> SurfaceVoxels:
    """Return the voxels of a shard's tree, with the moments of the surface in them."""
    voxels = stored.voxels(resolution)
    return replace(voxels, moments=surface_moments(stored.mesh(), voxels.grid))


def make_example(seed: int, resolution: int = 128, species: str | None = None, *, gusts: int = 0) -> Example:
    """Generate the dataset's tree of a seed and convert it; arguments as for `make_sample`."""
    sample = make_sample(seed, species, gusts=gusts)
    voxels, spectrum = voxel_spectrum(sample, resolution)
    return _example(voxels, sample.wind, spectrum)


def gust_pair(stored: StoredTree) -> tuple[Example, Example]:
    """Return a shard's tree in its wind, and in other gusts of the same mean wind."""
    return example_of(stored), make_example(stored.seed, species=stored.species, gusts=1)


def _example(voxels: SurfaceVoxels, wind: Wind, spectrum: SparseVoxelSpectrum) -> Example:
    tree = tree_features(voxels)
    turned = spectrum.coefficients @ wind_axes(wind).T / float(tree.height_m[0])
    return Example(tree=tree, wind=wind, spectrum=torch.from_numpy(turned.astype(np.complex64)))
