"""Generate one animated tree of the dataset from its seed."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex64, Float32, Int8, Int32

from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import NUM_FREQUENCIES, SparseVoxelSpectrum, Wind
from dynamictree.voxel.voxelize import SurfaceVoxels, surface_average, voxelize
from lab.dataset.mixed_species import MIXED_SPECIES, mix_species
from lab.dataset.motion import Sway, vertex_spectrum
from lab.dataset.sapling import Tree, grow_tree
from lab.dataset.species import SPECIES, Species
from lab.dataset.stem_skeleton import Skeleton, skeleton_of
from lab.dataset.wind import sway

VERSION = 5  # version of the generator; raised when the motion of a seed changes
GROWTH = 1  # raised when the tree or the gusts of a seed change
SPEED_M_S = (1.0, 25.0)  # uniform in the logarithm, from light air to a storm
GUST = (0.15, 0.45)
HELD_OUT_WEIGHT = 1 / 3  # relative probability of species that are only for evaluation
VALIDATION_EVERY = 20  # every n-th seed

Split = Literal["train", "validation", "unseen-species"]


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A tree, its wind, and its motion."""

    seed: int
    species: str
    split: Split
    wind: Wind
    mesh: TriangleMesh
    part: Int8[np.ndarray, " N"]  # stem level, or `sapling.LEAF`
    node: Int32[np.ndarray, " N"]  # node that each vertex follows
    skeleton: Skeleton
    motion: Sway  # motion of the nodes at every frame
    coefficients: Complex64[np.ndarray, "N K 3"]  # spectrum of every vertex [m]; zero is the tree without wind

    def displacement(self) -> Float32[np.ndarray, "T N 3"]:
        """Return the displacement of every vertex at every frame, also beyond the K frequencies [m]."""
        return self.motion.displacement(self.mesh.vertices, self.node)


def make_sample(seed: int, species: str | None = None, *, wind: Wind | None = None, gusts: int = 0) -> Sample:
    """Generate the tree and motion of a seed; the result is identical on every run and machine.

    By default the species (in `SPECIES`, or MIXED_SPECIES) and the wind are drawn from the seed. `gusts` is the index
    of the motion of this tree in this wind; the dataset has the first one.

    Raises:
        InputError: the species is unknown, or the seed is negative.
    """
    chosen, own_wind, tree, rng = _draw_tree(seed, species, wind)
    for _ in range(gusts + 1):
        motion = sway(tree, own_wind, rng)
    return Sample(
        seed=seed,
        species=chosen.name,
        split=split_of(seed, chosen),
        wind=own_wind,
        mesh=tree.mesh,
        part=tree.part,
        node=tree.node,
        skeleton=skeleton_of(tree.stems),
        motion=motion,
        coefficients=vertex_spectrum(motion, tree.mesh.vertices, tree.node, NUM_FREQUENCIES),
    )


def split_of(seed: int, species: Species) -> Split:
    """Return the split of the dataset that a tree belongs to."""
    if species.held_out:
        return "unseen-species"
    return "validation" if seed % VALIDATION_EVERY == 0 else "train"


def is_training_seed(seed: int) -> bool:
    """Return whether the tree of a seed is for training; draw only its species, without growing the tree."""
    rng = np.random.default_rng([GROWTH, seed])
    weights = np.array([HELD_OUT_WEIGHT if species.held_out else 1.0 for species in SPECIES.values()])
    drawn = list(SPECIES.values())[int(rng.choice(len(weights), p=weights / weights.sum()))]
    return split_of(seed, drawn) == "train"


def voxel_spectrum(sample: Sample, resolution: int = 128) -> tuple[SurfaceVoxels, SparseVoxelSpectrum]:
    """Return the sample's motion on its voxel grid, averaged over the surface in each voxel."""
    voxels = voxelize(sample.mesh, resolution)
    weights = surface_average(sample.mesh, voxels.grid)  # [V, N]
    count, num_frequencies, _ = sample.coefficients.shape
    flat = sample.coefficients.reshape(count, -1).view(np.float32)  # [N, 6K]
    averaged = np.ascontiguousarray(weights.astype(np.float32) @ flat).view(np.complex64)
    spectrum = SparseVoxelSpectrum(
        grid=voxels.grid,
        coefficients=averaged.reshape(-1, num_frequencies, 3),
        model=f"4dtree-{VERSION}",
        seed=sample.seed,
        wind=sample.wind,
    )
    return voxels, spectrum


def _draw_tree(seed: int, species: str | None, wind: Wind | None) -> tuple[Species, Wind, Tree, np.random.Generator]:
    if seed < 0:
        raise InputError(f"the seed is {seed}; it must be 0 or more")
    if species is not None and species not in (*SPECIES, MIXED_SPECIES):
        raise InputError(f"there is no species {species!r}; choose one of {', '.join((*SPECIES, MIXED_SPECIES))}")
    rng = np.random.default_rng([GROWTH, seed])
    names = list(SPECIES)
    weights = np.array([HELD_OUT_WEIGHT if SPECIES[name].held_out else 1.0 for name in names])
    drawn = names[int(rng.choice(len(names), p=weights / weights.sum()))]
    own_wind = Wind(
        speed_m_s=round(float(np.exp(rng.uniform(*np.log(SPEED_M_S)))), 3),
        direction_deg=round(float(rng.uniform(0, 360)), 2),
        gust=round(float(rng.uniform(*GUST)), 4),
    )
    chosen = mix_species(rng) if species == MIXED_SPECIES else SPECIES[species or drawn]
    return chosen, wind or own_wind, grow_tree(chosen, rng), rng
