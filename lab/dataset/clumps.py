"""Foliage as closed clumps, one per stem, as in low-poly models of trees."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import trimesh
from jaxtyping import Float32, Int32

from lab.dataset.branching import Stems, normalised, perpendicular, rotate
from lab.dataset.leaves import LOWEST_M
from lab.dataset.species import Foliage
from lab.dataset.tubes import Surface, own_rings

CENTRE = 0.75  # position of the clump's centre [share of the stem's length]
ROUGHNESS = 0.12  # relative standard deviation of the radius over vertices
SIZE_SPREAD = 0.3


def clumps(foliage: Foliage, height_m: float, stems: Sequence[Stems], rng: np.random.Generator) -> Surface:
    """Grow a clump on every stem of the last level and on the trunk, each rigidly attached to one node of its stem.

    Args:
        foliage: `size` is a clump's radius over the height, `aspect` its radius across over that along.
        height_m: height of the tree [m].
        stems: stems by level.
        rng: random generator of this tree.

    Returns:
        A surface; its node indices run over the stems of all levels.
    """
    starts = np.cumsum([0, *(int(own_rings(level).sum()) for level in stems)])
    bearing = sorted({0, len(stems) - 1})
    grown = [_on_level(foliage, height_m, stems[depth], int(starts[depth]), rng) for depth in bearing]
    sizes = np.cumsum([0, *(len(surface.vertices) for surface in grown)])
    return Surface(
        vertices=np.concatenate([surface.vertices for surface in grown]),
        faces=np.concatenate([surface.faces + start for surface, start in zip(grown, sizes[:-1], strict=True)]).astype(
            np.int32
        ),
        node=np.concatenate([surface.node for surface in grown]),
    )


def _on_level(foliage: Foliage, height_m: float, stems: Stems, first_node: int, rng: np.random.Generator) -> Surface:
    own = own_rings(stems)
    rows = np.arange(len(stems.points))
    ring = np.clip(np.round(stems.first + CENTRE * (stems.segments - stems.first)), 1, stems.segments).astype(np.int32)
    node = (first_node + np.cumsum(own).reshape(own.shape) - 1)[rows, ring].astype(np.int32)
    along = normalised(stems.points[rows, ring] - stems.points[rows, ring - 1])
    side = rotate(perpendicular(along), along, rng.uniform(0, 2 * np.pi, len(rows)).astype(np.float32))
    frame = np.stack([along, side, np.cross(along, side)], axis=1)  # [M, 3, 3]
    ball, faces = _ball()
    longest = stems.length_m.max()
    radius = foliage.size * height_m * np.sqrt(stems.length_m / longest)
    radius = radius * rng.uniform(1 - SIZE_SPREAD, 1 + SIZE_SPREAD, len(rows))
    shape = np.array([1.0, foliage.aspect, foliage.aspect], np.float32)
    rough = 1 + ROUGHNESS * rng.standard_normal((len(rows), len(ball), 1), np.float32)
    local = radius[:, None, None] * rough * ball * shape
    vertices = stems.points[rows, ring][:, None] + np.einsum("mva,max->mvx", local, frame)
    vertices[:, :, 2] = np.maximum(vertices[:, :, 2], LOWEST_M)
    return Surface(
        vertices=vertices.reshape(-1, 3).astype(np.float32),
        faces=(rows[:, None, None] * len(ball) + faces).reshape(-1, 3).astype(np.int32),
        node=np.repeat(node, len(ball)),
    )


@cache
def _ball() -> tuple[Float32[np.ndarray, "B 3"], Int32[np.ndarray, "F 3"]]:
    """Return vertices and faces of a sphere of radius 1."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    return sphere.vertices.astype(np.float32), sphere.faces.astype(np.int32)
