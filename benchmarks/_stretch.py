"""Stretch of a mesh's edges and leaf cards in a motion, and the trees of the storm benchmarks."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynamictree.commands.input_files import load_mesh
from dynamictree.mesh import TriangleMesh, edges_of
from lab.dataset.sample import make_sample

MESHES = ("mesh/tree-lime.glb", "mesh/quaternius_common_tree/CommonTree_2.obj")
SPECIES = ("weeping", "palm", "pine", "round-broadleaf")


def trees() -> Iterator[tuple[str, TriangleMesh]]:
    """Iterate over generated trees and meshes of DYNAMICTREE_SAMPLES."""
    for seed, species in enumerate(SPECIES):
        yield species, make_sample(seed, species).mesh
    samples = os.environ.get("DYNAMICTREE_SAMPLES")
    for name in MESHES if samples else ():
        yield name, load_mesh(Path(str(samples)) / name)


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Lengths of the edges and areas of the cards of a mesh at rest."""

    vertices: np.ndarray  # [N, 3], m
    edges: np.ndarray  # [E, 2]
    cards: np.ndarray  # [F, 3]

    @classmethod
    def of(cls, mesh: TriangleMesh, in_card: np.ndarray) -> "Sizes":
        """Measure a mesh at rest; `in_card` marks vertices of cards."""
        return cls(
            vertices=mesh.vertices, edges=edges_of(mesh.faces), cards=mesh.faces[in_card[mesh.faces].all(axis=1)]
        )

    def growth_percent(self, motion: Iterable[np.ndarray]) -> tuple[float, float]:
        """Return the 99th percentiles of the growth of edges and of cards over a motion's frames [N, 3] [%]."""
        frames = [self.vertices, *(self.vertices + frame for frame in motion)]
        edges = [_lengths(frame[self.edges]) for frame in frames]
        return _growth(edges), _growth([_areas(frame[self.cards]) for frame in frames])


def _growth(sizes: list[np.ndarray]) -> float:
    rest = sizes[0]
    if not (rest > 0).any():
        return 0.0
    change = [np.abs(size[rest > 0] / rest[rest > 0] - 1) for size in sizes[1:]]
    return round(100 * float(np.percentile(change, 99)), 2)


def _lengths(ends: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(ends[:, 0].astype(np.float64) - ends[:, 1], axis=1))


def _areas(corners: np.ndarray) -> np.ndarray:
    corners = corners.astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.linalg.norm(across, axis=1) / 2)
