"""Generate a tree from a species and a random generator: stems, leaves and mesh."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import trimesh
from jaxtyping import Float32, Int8, Int32

from dynamictree.mesh import Material, MeshLook, TriangleMesh
from lab.dataset.branching import Stems, grow_children, grow_trunks, normalised, perpendicular, rotate
from lab.dataset.leaves import LOWEST_M, Leaves, cards, grow_leaves
from lab.dataset.species import Foliage, Species
from lab.dataset.tubes import Surface, own_rings, tubes

LEAF = 9  # part label of leaves; wood has its level, 0 to 3
THIN_SHARE = 0.3  # leaf count of the level above, over the last level's
CENTRE = 0.75  # position of the clump's centre [share of the stem's length]
ROUGHNESS = 0.12  # relative standard deviation of the radius over vertices
SIZE_SPREAD = 0.3


@dataclass(frozen=True, kw_only=True)
class Tree:
    """A tree at rest. Nodes are the stems' own rings, level after level, then the leaves."""

    species: Species  # parameters as perturbed for this tree
    stems: tuple[Stems, ...]  # stems by level
    leaves: tuple[Leaves, ...]
    mesh: TriangleMesh
    part: Int8[np.ndarray, " N"]
    node: Int32[np.ndarray, " N"]  # node that each vertex follows

    @property
    def bare(self) -> bool:
        """Return whether the tree has no leaves."""
        return self.species.foliage.kind == "none"


def grow_tree(species: Species, rng: np.random.Generator) -> Tree:
    """Grow one tree of a species, with randomly perturbed parameters."""
    own = species.perturbed(rng)
    stems = [grow_trunks(own, rng)]
    for depth in range(1, len(own.levels)):
        stems.append(grow_children(own, depth, stems[-1], rng))
    leaves = []
    if own.foliage.kind == "clump":
        return _surface(own, tuple(stems), (), clumps(own.foliage, own.height_m[0], stems, rng))
    if own.foliage.kind != "none":
        leaves.append(grow_leaves(own.foliage, own.height_m[0], stems[-1], len(stems) - 1, rng))
        if len(stems) > 2:
            thin = replace(own.foliage, count=own.foliage.count * THIN_SHARE)
            leaves.append(grow_leaves(thin, own.height_m[0], stems[-2], len(stems) - 2, rng))
    return _surface(own, tuple(stems), tuple(leaves))


def _surface(
    species: Species, stems: tuple[Stems, ...], leaves: tuple[Leaves, ...], on_stems: Surface | None = None
) -> Tree:
    """Combine the surfaces; `on_stems` is foliage that follows the stems' own nodes."""
    surfaces = [tubes(level, on_ground=depth == 0) for depth, level in enumerate(stems)]
    labels = list(range(len(stems)))
    num_nodes = [int(own_rings(level).sum()) for level in stems]
    for bunch in leaves:
        surfaces.append(cards(bunch, species.foliage))
        labels.append(LEAF)
        num_nodes.append(len(bunch.base))
    first_node = np.cumsum([0, *num_nodes[:-1]]).tolist()
    if on_stems is not None:
        surfaces.append(on_stems)
        labels.append(LEAF)
        first_node.append(0)
    sizes = [len(surface.vertices) for surface in surfaces]
    first_vertex = np.cumsum([0, *sizes[:-1]])
    material = np.repeat(
        np.array([label == LEAF for label in labels], np.int32), [len(surface.faces) for surface in surfaces]
    )
    mesh = TriangleMesh(
        vertices=np.concatenate([surface.vertices for surface in surfaces]),
        faces=np.concatenate(
            [surface.faces + start for surface, start in zip(surfaces, first_vertex, strict=True)]
        ).astype(np.int32),
        look=MeshLook(
            face_material=material.astype(np.int32),
            materials=(
                Material(name="bark", base_color=(*species.bark, 1.0)),
                Material(name="leaf", base_color=(*species.foliage.color, 1.0)),
            ),
        ),
    )
    return Tree(
        species=species,
        stems=stems,
        leaves=leaves,
        mesh=mesh,
        part=np.repeat(np.array(labels, np.int8), sizes),
        node=np.concatenate([surface.node + start for surface, start in zip(surfaces, first_node, strict=True)]).astype(
            np.int32
        ),
    )


def clumps(foliage: Foliage, height_m: float, stems: Sequence[Stems], rng: np.random.Generator) -> Surface:
    """Grow a clump on every stem of the last level and on the trunk, each rigidly attached to one node of its stem.

    The foliage's `size` is a clump's radius over the height, `aspect` its radius across over that along. Node indices
    run over the stems of all levels.
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
