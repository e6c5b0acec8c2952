"""Trees that no training sees, each moved by two true winds of one kind."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex64

from dynamictree.dataset.motion import vertex_spectrum
from dynamictree.dataset.sapling import grow_tree
from dynamictree.dataset.species import SPECIES
from dynamictree.dataset.wind import sway
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import Wind
from dynamictree.voxel.voxelize import SurfaceVoxels, voxelize

STREAM = 7_000_001
"""First word of these trees' seeds; the dataset's own begin with its version."""
SPEED_M_S = (2.0, 10.0)
GUST = (0.15, 0.45)

Group = Literal["seen-species", "unseen-species"]


@dataclass(frozen=True, kw_only=True)
class JudgedTree:
    """A tree and how it truly moves, twice: the same wind, other gusts."""

    species: str
    wind: Wind
    mesh: TriangleMesh
    voxels: SurfaceVoxels
    truth: Complex64[np.ndarray, "N K 3"]  # [m]
    second: Complex64[np.ndarray, "N K 3"]


def iter_judged(group: Group, count: int, *, resolution: int = 128) -> Iterator[JudgedTree]:
    """`count` trees, the group's species in turn."""
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
        yield JudgedTree(
            species=chosen.name,
            wind=wind,
            mesh=tree.mesh,
            voxels=voxelize(tree.mesh, resolution),
            truth=truth,
            second=second,
        )
