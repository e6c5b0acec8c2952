"""Bones under the voxels: which stretches of the tree turn as one.

Voxels at the same distance from the root that hang together form a node; a bone leads from each node's parent to it.
Bones turn and do not stretch, so what is built on them bends however far it is pushed.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Complex64, Float32, Int32, Int64

from dynamictree.modal.locality import STRANGER, strangeness
from dynamictree.modal.system import ModalSystem
from dynamictree.voxel.graph import root_rows, voxel_graph

BONE_VOXELS = 10.0  # length of a bone, in voxels
APART = 0.125  # strangeness above which touching voxels are no neighbours
SMALLEST_NODE = 24  # voxels; smaller ones, mostly single leaves and twigs, are part of their parent
SOFTENING_VOXELS = 1.0  # a bone much shorter than this does not turn: its direction is chance


@dataclass(frozen=True, kw_only=True)
class Bones:
    """B rigid bodies, parents before children. At rest a bone leads from `joint_m` to `joint_m + reach_m`."""

    parent: Int32[np.ndarray, " B"]  # -1 at the root
    joint_m: Float32[np.ndarray, "B 3"]  # the parent's centre, about which the bone turns
    reach_m: Float32[np.ndarray, "B 3"]  # from the joint to the bone's own centre
    lever_m2: Float32[np.ndarray, " B"]  # |reach|² and some more, so that a very short bone hardly turns
    shapes: Complex64[np.ndarray, "B M 3"]  # φ at the bone's centre: the mean of its voxels [m]
    bone_of_voxel: Int32[np.ndarray, " V"]


def bones_of(system: ModalSystem) -> Bones:
    """Read bones and their turning from a spectrum's voxels; a second or so for 30,000 voxels."""
    bone_of_voxel, parent = _nodes(system)
    count = np.bincount(bone_of_voxel, minlength=len(parent)).astype(np.float64)
    mean = scipy.sparse.csr_array(
        (1 / count[bone_of_voxel], (bone_of_voxel, np.arange(len(bone_of_voxel)))),
        shape=(len(parent), len(system.grid)),
    )
    centre = mean @ system.grid.centres_m.astype(np.float64)  # [B, 3]
    flat = system.shapes.reshape(len(system.grid), -1)
    shape = (mean @ flat).reshape(len(parent), system.num_modes, 3)
    above = np.where(parent < 0, np.arange(len(parent)), parent)
    reach = centre - centre[above]
    lever = (reach**2).sum(axis=1) + (SOFTENING_VOXELS * system.grid.voxel_size_m) ** 2
    return Bones(
        parent=parent,
        joint_m=centre[above].astype(np.float32),
        reach_m=reach.astype(np.float32),
        lever_m2=lever.astype(np.float32),
        shapes=shape.astype(np.complex64),
        bone_of_voxel=bone_of_voxel,
    )


def _nodes(system: ModalSystem) -> tuple[Int32[np.ndarray, " V"], Int32[np.ndarray, " B"]]:
    """Which node each voxel is of, and each node's parent; nodes in order of their distance from the root."""
    from scipy.sparse.csgraph import connected_components, dijkstra

    grid = system.grid
    edges = voxel_graph(grid).tocoo()
    strange = strangeness(system, edges.row, edges.col)
    length = edges.data * (1 + STRANGER * strange)
    graph = scipy.sparse.csr_array((length, (edges.row, edges.col)), shape=(len(grid), len(grid)))
    roots = root_rows(graph, grid)
    distance, before, _ = dijkstra(graph, indices=roots, min_only=True, return_predecessors=True)
    way = _plain_length(grid.centres_m, distance, before)
    ring = np.floor(way / (BONE_VOXELS * grid.voxel_size_m)).astype(np.int64)
    together = (ring[edges.row] == ring[edges.col]) & (strange < APART)
    same = scipy.sparse.csr_array(
        (np.ones(together.sum(), np.int8), (edges.row[together], edges.col[together])), shape=graph.shape
    )
    _, node = connected_components(same, directed=False)
    node = np.where(before < 0, node[roots[0]], node)  # the root is one node, whatever its shape
    parent = _parents(node.astype(np.int64), before, distance)
    return _merge_small(node.astype(np.int64), parent, distance)


def _plain_length(
    centres: Float32[np.ndarray, "V 3"], distance: np.ndarray, before: Int32[np.ndarray, " V"]
) -> np.ndarray:
    """Length in metres of each voxel's shortest way, whose edges were weighed otherwise."""
    step = np.where(before < 0, 0, np.linalg.norm(centres - centres[np.maximum(before, 0)], axis=1))
    way = np.zeros(len(centres))
    for voxel in np.argsort(distance, kind="stable"):
        if before[voxel] >= 0:
            way[voxel] = way[before[voxel]] + step[voxel]
    return way


def _parents(
    node: Int64[np.ndarray, " V"], before: Int32[np.ndarray, " V"], distance: np.ndarray
) -> Int64[np.ndarray, " B"]:
    """The node from which a node's nearest voxel is reached: always nearer to the root, so there is no cycle."""
    parent = np.full(int(node.max()) + 1, -1, np.int64)
    order = np.argsort(distance, kind="stable")
    first = order[np.unique(node[order], return_index=True)[1]]  # of each node, the voxel nearest to the root
    reached = before[first]
    present = node[first]
    parent[present[reached >= 0]] = node[reached[reached >= 0]]
    return parent


def _merge_small(
    node: Int64[np.ndarray, " V"], parent: Int64[np.ndarray, " A"], distance: np.ndarray
) -> tuple[Int32[np.ndarray, " V"], Int32[np.ndarray, " B"]]:
    """Give the voxels of small nodes to the nearest ancestor that is not, and number what remains from the root."""
    nearest = np.full(len(parent), np.inf)
    np.minimum.at(nearest, node, distance)
    size = np.bincount(node, minlength=len(parent))
    target = np.arange(len(parent))
    order = np.argsort(nearest, kind="stable")
    for this in order:
        if parent[this] >= 0 and size[this] < SMALLEST_NODE:
            target[this] = target[parent[this]]
    roots = [this for this in order if target[this] == this and size[this] > 0]
    number = np.full(len(parent), -1, np.int64)
    number[roots] = np.arange(len(roots))
    above = parent[roots]
    numbered = np.where(above < 0, -1, number[target[above]])
    return number[target[node]].astype(np.int32), numbered.astype(np.int32)
