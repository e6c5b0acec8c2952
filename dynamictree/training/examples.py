"""From the dataset's trees to what a training step eats; kept on disk, because a tree is seen many times."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Complex64
from safetensors.torch import load_file, save_file
from torch import Tensor

from dynamictree.dataset.sample import HELD_OUT_WEIGHT, VERSION, make_sample, split_of, voxel_spectrum
from dynamictree.dataset.species import SPECIES
from dynamictree.diffusion.condition import NUM_LEVELS, TreeCondition, tree_condition
from dynamictree.diffusion.prepared import wind_axes
from dynamictree.sparse.level import pyramid
from dynamictree.spectrum import Wind

HALF_SCALE = 1000.0
"""Spectra over the height are 1e-5 to 0.1; times this they sit well in float16."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """One tree, its wind, and its motion as a share of its height in the wind's frame."""

    tree: TreeCondition
    wind: Wind
    spectrum: Complex64[Tensor, "V K 3"]


def is_training_seed(seed: int) -> bool:
    """Whether the dataset's tree of a seed is for training: not of a held-out species, not for validation.

    The species is the first thing that the dataset draws from a seed; this draws it without growing the tree.
    """
    rng = np.random.default_rng([VERSION, seed])
    weights = np.array([HELD_OUT_WEIGHT if species.held_out else 1.0 for species in SPECIES.values()])
    drawn = list(SPECIES.values())[int(rng.choice(len(weights), p=weights / weights.sum()))]
    return split_of(seed, drawn) == "train"


def make_example(seed: int, resolution: int = 128) -> Example:
    """The dataset's tree of a seed."""
    sample = make_sample(seed)
    voxels, spectrum = voxel_spectrum(sample, resolution)
    tree = tree_condition(voxels.grid, voxels.normals)
    turned = spectrum.coefficients @ wind_axes(sample.wind).T / float(tree.height_m[0])
    return Example(tree=tree, wind=sample.wind, spectrum=torch.from_numpy(turned.astype(np.complex64)))


def cached_example(folder: Path, seed: int, resolution: int = 128) -> Example:
    """`make_example`, made at most once a folder (float16 on disk)."""
    path = folder / f"{resolution}-{seed:06d}.safetensors"
    if not path.exists():
        example = make_example(seed, resolution)
        wind = example.wind
        tensors = {
            "coords": example.tree.grids.levels[0].coords.to(torch.int16),
            "scalars": example.tree.scalars.half(),
            "vectors": example.tree.vectors.half(),
            "height_m": example.tree.height_m,
            "links": example.tree.links.to(torch.int32),
            "spectrum": torch.view_as_real(example.spectrum * HALF_SCALE).half(),
            "wind": torch.tensor([wind.speed_m_s, wind.direction_deg, wind.gust]),
        }
        partial = path.with_suffix(".partial")
        save_file(tensors, partial)
        partial.rename(path)
    stored = load_file(path)
    speed, direction, gust = stored["wind"].tolist()
    tree = TreeCondition(
        grids=pyramid(stored["coords"].long(), NUM_LEVELS),
        scalars=stored["scalars"].float(),
        vectors=stored["vectors"].float(),
        height_m=stored["height_m"],
        links=stored["links"].long(),
    )
    return Example(
        tree=tree,
        wind=Wind(speed_m_s=speed, direction_deg=direction, gust=gust),
        spectrum=torch.view_as_complex(stored["spectrum"].float() / HALF_SCALE),
    )


def prepare_examples(folder: Path, seeds: Sequence[int], *, num_processes: int = 2) -> Iterator[int]:
    """Make the examples that the folder lacks, giving each seed when it is there."""
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(num_processes) as pool:
        yield from pool.map(_prepare, [folder] * len(seeds), seeds, chunksize=4)


def _prepare(folder: Path, seed: int) -> int:
    torch.set_num_threads(1)
    cached_example(folder, seed)
    return seed
