"""Generate a tree from a species and a random generator: stems, leaves and mesh."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int8, Int32

from dynamictree.mesh import Material, MeshLook, TriangleMesh
from lab.dataset.branching import Stems, grow_children, grow_trunks
from lab.dataset.clumps import clumps
from lab.dataset.leaves import Leaves, cards, grow_leaves
from lab.dataset.species import Species
from lab.dataset.tubes import Surface, own_rings, tubes

LEAF = 9  # part label of leaves; wood has its level, 0 to 3
THIN_SHARE = 0.3  # leaf count of the level above, over the last level's


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
