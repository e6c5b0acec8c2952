"""Held-out trees, each with two simulated motions in the same wind."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Complex64, Float32

from dynamictree.errors import FormatError, InputError
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import Wind, from_motion
from dynamictree.voxel.voxelize import SurfaceVoxels, voxelize
from lab.dataset.motion import vertex_spectrum
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from lab.dataset.wind import sway

STREAM = 7_000_001
"""First word of the seeds of held-out trees; the dataset's seeds begin with its version."""
SPEED_M_S = (2.0, 10.0)
GUST = (0.15, 0.45)

SAPLING_WIND = Wind(speed_m_s=7.5, direction_deg=-90.0)
"""Our equivalent of the add-on's wind 1, which blows along −Y: our stems bend as far, see docs/decisions/dataset.md."""
ARRAYS = ("vertices", "rest", "faces")


@dataclass(frozen=True, kw_only=True)
class HeldOutTree:
    """A tree and its true motion; generated trees also have a second motion in other gusts of the same mean wind."""

    species: str
    wind: Wind
    mesh: TriangleMesh
    voxels: SurfaceVoxels
    truth: Complex64[np.ndarray, "N K 3"]  # [m]
    second: Complex64[np.ndarray, "N K 3"] | None = None


def iter_sapling(files: Sequence[Path], *, resolution: int = 128) -> Iterator[HeldOutTree]:
    """Iterate over trees of Blender's Sapling add-on, which another simulator moves."""
    for path in files:
        tree = read_sapling(path)
        yield HeldOutTree(
            species=tree.name,
            wind=SAPLING_WIND,
            mesh=tree.mesh,
            voxels=voxelize(tree.mesh, resolution),
            truth=from_motion(tree.displacement),
        )


SpeciesGroup = Literal["seen-species", "unseen-species"]
Group = Literal["seen-species", "unseen-species", "sapling"]


def iter_held_out(group: SpeciesGroup, count: int, *, resolution: int = 128) -> Iterator[HeldOutTree]:
    """Iterate over `count` trees, the group's species in turn."""
    held_out = group == "unseen-species"
    species = [one for one in SPECIES.values() if one.held_out == held_out]
    for index in range(count):
        chosen = species[index % len(species)]
        rng = np.random.default_rng([STREAM, int(held_out), index])
        wind = Wind(
            speed_m_s=float(rng.uniform(*SPEED_M_S)),
            direction_deg=float(rng.uniform(0, 360)),
            gust=float(rng.uniform(*GUST)),
        )
        tree = grow_tree(chosen, rng)
        truth, second = (vertex_spectrum(sway(tree, wind, rng), tree.mesh.vertices, tree.node) for _ in range(2))
        yield HeldOutTree(
            species=chosen.name,
            wind=wind,
            mesh=tree.mesh,
            voxels=voxelize(tree.mesh, resolution),
            truth=truth,
            second=second,
        )


@dataclass(frozen=True, kw_only=True)
class SaplingTree:
    """One tree of the Sapling add-on with its motion."""

    name: str
    mesh: TriangleMesh
    displacement: Float32[np.ndarray, "T N 3"]  # displacement from the rest pose [m]


def sapling_files(folder: Path) -> list[Path]:
    """List the trees in a folder, or in its subfolder `sapling`.

    Raises:
        InputError: there are no trees.
    """
    inner = folder / "sapling"
    files = sorted((inner if inner.is_dir() else folder).glob("*.npz"))
    if not files:
        raise InputError(f"there is no .npz of a Sapling tree in {folder} or {inner}; give the folder that holds them")
    return files


def read_sapling(path: Path) -> SaplingTree:
    """Read one tree without its skeleton.

    Raises:
        FormatError: an array is missing.
    """
    with np.load(path, allow_pickle=False) as baked:
        missing = [name for name in ARRAYS if name not in baked]
        if missing:
            raise FormatError(f"{path} lacks {', '.join(missing)}; a tree has the arrays {', '.join(ARRAYS)}")
        moved, rest, faces = (baked[name] for name in ARRAYS)
    return SaplingTree(name=path.stem, mesh=TriangleMesh(vertices=rest, faces=faces), displacement=moved - rest)
