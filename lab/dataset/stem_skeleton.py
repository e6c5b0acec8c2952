"""Skeleton of the stems: one node per ring, and a bone from each node to its parent."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int8, Int32

from lab.dataset.branching import Stems
from lab.dataset.tubes import own_rings


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """Nodes level by level, in the order of the tree's nodes without the leaves."""

    position: Float32[np.ndarray, "B 3"]  # [m]
    radius: Float32[np.ndarray, " B"]  # radius of the tube [m]
    parent: Int32[np.ndarray, " B"]  # node towards the root; -1 on the ground
    level: Int8[np.ndarray, " B"]
    stem: Int32[np.ndarray, " B"]
    stem_length_m: Float32[np.ndarray, " S"]


def skeleton_of(levels: tuple[Stems, ...]) -> Skeleton:
    """List the rings of all levels as nodes. The parent of a stem's first ring is its parent's ring just below."""
    parts: list[tuple[np.ndarray, ...]] = []
    above: Int32[np.ndarray, "M P"] = np.zeros((0, 0), np.int32)
    num_nodes = num_stems = 0
    for depth, stems in enumerate(levels):
        own = own_rings(stems)
        node = (num_nodes + np.cumsum(own).reshape(own.shape) - 1).astype(np.int32)  # [M, R+1]
        parent = np.concatenate([np.full((len(node), 1), -1, np.int32), node[:, :-1]], axis=1)
        rows = np.arange(len(node))
        below = stems.parent_ring.astype(np.int32)
        forked = stems.first > 0
        parent[rows[forked], stems.first[forked]] = node[stems.parent[forked], below[forked]]
        if depth:
            parent[~forked, 0] = above[stems.parent[~forked], below[~forked]]
        stem = np.broadcast_to((num_stems + rows)[:, None], own.shape)
        parts.append((stems.points[own], stems.radii[own], parent[own], np.full(own.sum(), depth), stem[own]))
        above, num_nodes, num_stems = node, num_nodes + int(own.sum()), num_stems + len(node)
    position, radius, parents, level, stem = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Skeleton(
        position=position,
        radius=radius,
        parent=parents.astype(np.int32),
        level=level.astype(np.int8),
        stem=stem.astype(np.int32),
        stem_length_m=np.concatenate([stems.length_m for stems in levels]),
    )
