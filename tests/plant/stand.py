"""Trees to tell apart: stems with crowns of leaf cards that touch; and generated ones."""

from functools import cache

import numpy as np
from jaxtyping import Float32, Float64, Int64

from dynamictree.mesh import TriangleMesh, join_meshes
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES

PLACES_M = ((0.0, 0.0), (3.0, 0.5), (0.8, 3.1), (4.2, 3.6), (-2.6, 2.2))
HEIGHTS_M = (8.0, 7.0, 8.5, 7.5, 6.5)


@cache
def grown(species: str, seed: int = 4) -> TriangleMesh:
    """A generated tree, grown once for all tests of a process."""
    return grow_tree(SPECIES[species], np.random.default_rng(seed)).mesh


def tree(height_m: float, *, seed: int = 0, num_cards: int = 250) -> TriangleMesh:
    """A stem of eight sides and cards at random in a ball around its upper half."""
    rng = np.random.default_rng(seed)
    turn = 2 * np.pi * np.arange(8) / 8
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) * 0.018 * height_m
    heights = np.linspace(0, 0.85 * height_m, 9)
    stem = np.concatenate([np.c_[ring * (1 - 0.6 * z / height_m), np.full(8, z)] for z in heights])
    i, j = np.divmod(np.arange(64), 8)
    low, next_low = 8 * i + j, 8 * i + (j + 1) % 8
    sides = np.concatenate([np.c_[low, next_low, next_low + 8], np.c_[low, next_low + 8, low + 8]])
    away = rng.normal(size=(num_cards, 3))
    away *= np.cbrt(rng.random((num_cards, 1))) / np.linalg.norm(away, axis=1, keepdims=True)
    middles = away * [0.2 * height_m, 0.2 * height_m, 0.28 * height_m] + [0, 0, 0.7 * height_m]
    along, across = np.linalg.qr(rng.normal(size=(num_cards, 3, 2)))[0].transpose(2, 0, 1) * 0.03 * height_m
    cards = middles[:, None] + np.stack([-along - across, along - across, along + across, across - along], axis=1)
    squares = 4 * np.arange(num_cards)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return TriangleMesh(
        vertices=np.concatenate([stem, cards.reshape(-1, 3)]).astype(np.float32),
        faces=np.concatenate([sides, len(stem) + squares.reshape(-1, 3)]).astype(np.int32),
    )


def stand_of_five() -> tuple[TriangleMesh, Int64[np.ndarray, " F"]]:
    """Five trees in one mesh, and the tree of each face."""
    parts = []
    for seed, (place, height_m) in enumerate(zip(PLACES_M, HEIGHTS_M, strict=True)):
        one = tree(height_m, seed=seed)
        parts.append(one.with_vertices(one.vertices + np.float32([*place, 0])))
    return join_meshes(parts), np.repeat(np.arange(5), [part.num_faces for part in parts])


def on_ground(
    points: Float64[np.ndarray, "P 3"], *, slope: float = 0.1
) -> tuple[Float64[np.ndarray, "Q 3"], Float64[np.ndarray, "R 3"]]:
    """Points lifted onto a slope, and points of the ground under and around them."""
    rng = np.random.default_rng(1)
    low, high = points[:, :2].min(axis=0) - 1, points[:, :2].max(axis=0) + 1
    flat = rng.uniform(low, high, size=(20_000, 2))
    ground = np.c_[flat, slope * flat[:, 0] + rng.normal(scale=0.02, size=len(flat))]
    return points + np.c_[np.zeros((len(points), 2)), slope * points[:, 0]], ground


def share_right(labels: Int64[np.ndarray, " P"], truth: Int64[np.ndarray, " P"]) -> float:
    """Share of points whose label is that which most of their tree have."""
    of_each = (labels[truth == one] for one in np.unique(truth))
    return float(np.mean([(own == np.bincount(own + 1).argmax() - 1).mean() for own in of_each]))


def scattered(mesh: TriangleMesh, face: Int64[np.ndarray, " P"]) -> Float32[np.ndarray, "P 3"]:
    """A point at random on each of some faces."""
    rng = np.random.default_rng(2)
    weights = rng.dirichlet(np.ones(3), len(face)).astype(np.float32)
    return np.einsum("pi,pic->pc", weights, mesh.vertices[mesh.faces[face]])
