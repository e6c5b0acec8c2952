"""Bones under the voxels: which stretches of the tree turn as one.

Voxels at the same distance from the root that hang together form a node. A bone leads from the centre of a node's
parent to that of the node, and carries the voxels around this line, so bones meet at the joints between them. Bones
turn and do not stretch, so what is built on them bends however far it is pushed.

A node's centre is the mean of its voxels by flow, the number of voxels whose path to the root leads through each: it
lies in the wood, whatever leaves are around it.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Bool, Complex64, Float32, Float64, Int32, Int64

from dynamictree.modal.locality import unlikeness
from dynamictree.modal.system import ModalSystem
from dynamictree.voxel.graph import stand_graph, stand_roots

BONE_VOXELS = 5.0  # length of a bone, in voxels
DETOUR = 100.0  # an edge is as many times longer whose ends move as unlike as strangers do
WAY_POWER, WAY_FLOOR = 0.5, 0.1
"""On the way to the root slow modes count more, since in fast ones the leaves of a stem are as unlike as strangers; and
below this share of the mean motion, as at the foot, noise is no sign of another stem."""
APART = 0.5  # unlikeness above which touching voxels are no neighbours
SMALLEST_NODE = 2.4  # voxels per voxel of length; smaller ones, mostly leaves and twigs, are part of their parent
SOFTENING_VOXELS = 0.5  # a bone much shorter than this does not turn: its direction is chance


@dataclass(frozen=True, kw_only=True)
class Bones:
    """B rigid bodies, parents before children. At rest a bone leads from `joint_m` to `joint_m + reach_m`."""

    parent: Int32[np.ndarray, " B"]  # -1 at a tree's root
    joint_m: Float32[np.ndarray, "B 3"]  # the parent's centre, about which the bone turns
    reach_m: Float32[np.ndarray, "B 3"]  # from the joint to the bone's own centre
    lever_m2: Float32[np.ndarray, " B"]  # |reach|² and some more, so that a very short bone hardly turns
    shapes: Complex64[np.ndarray, "B M 3"]  # φ at the bone's centre [m]
    bone_of_voxel: Int32[np.ndarray, " V"]


@dataclass(frozen=True, kw_only=True)
class _Paths:
    """Each voxel's cheapest path to the root."""

    order: Int64[np.ndarray, " V"]  # from the root outward
    before: Int32[np.ndarray, " V"]  # next voxel towards the root; negative at the root
    length_m: Float64[np.ndarray, " V"]


@dataclass(frozen=True, kw_only=True)
class _Nodes:
    """Voxels that turn together. A node's own voxels are all but those of small nodes that became part of it."""

    of_voxel: Int64[np.ndarray, " V"]
    own: Bool[np.ndarray, " V"]
    parent: Int32[np.ndarray, " B"]


def bones_of(system: ModalSystem, *, length_voxels: float = BONE_VOXELS) -> Bones:
    """Read bones of a length and their turning from a spectrum's voxels; a second or so for 30,000 voxels.

    Each of several trees has a root.
    """
    paths, nodes = _nodes(system, length_voxels)
    parent = nodes.parent
    flow = np.where(nodes.own, _flow(paths), 0)
    share = flow / np.bincount(nodes.of_voxel, flow)[nodes.of_voxel]
    mean = scipy.sparse.csr_array(
        (share, (nodes.of_voxel, np.arange(len(share)))), shape=(len(parent), len(system.grid))
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
        bone_of_voxel=_carriers(system.grid.centres_m, paths, nodes, centre),
    )


def _flow(paths: _Paths) -> Float64[np.ndarray, " V"]:
    """Number of voxels whose path leads through each, its own included."""
    flow = np.ones(len(paths.order))
    for voxel in paths.order[::-1]:
        if paths.before[voxel] >= 0:
            flow[paths.before[voxel]] += flow[voxel]
    return flow


def _carriers(
    points: Float32[np.ndarray, "V 3"], paths: _Paths, nodes: _Nodes, centre: Float64[np.ndarray, "B 3"]
) -> Int32[np.ndarray, " V"]:
    """The bone of each voxel: its node's own, or that of a child whose line from the node's centre is nearer."""
    carrier = nodes.of_voxel.astype(np.int32)
    first = np.full(len(centre), -1, np.int64)
    first[carrier[paths.order[::-1]]] = paths.order[::-1]  # of each node, the voxel nearest to the root
    free = nodes.own & (paths.before >= 0)
    free[first] = False  # so every bone has a voxel
    members = np.flatnonzero(free)[np.argsort(nodes.of_voxel[free], kind="stable")]
    ends = np.searchsorted(nodes.of_voxel[members], np.arange(len(centre) + 1))
    for bone, above in enumerate(nodes.parent):
        voxels, children = members[ends[bone] : ends[bone + 1]], np.flatnonzero(nodes.parent == bone)
        leaves_at = points[paths.before[first[children]]].astype(np.float64)  # where the children leave the node
        start = np.concatenate(
            [centre[[bone if above < 0 else above]], np.repeat(centre[[bone]], len(children), axis=0)]
        )
        gaps = _gaps(points[voxels], start, np.concatenate([centre[[bone]], leaves_at]))  # [n, 1 + children]
        carrier[voxels] = np.concatenate([[bone], children])[gaps.argmin(axis=1)]
    for voxel in paths.order[~nodes.own[paths.order]]:
        carrier[voxel] = carrier[paths.before[voxel]]  # what is small rides on the voxel that it grows from
    return carrier


def _gaps(
    points: Float32[np.ndarray, "n 3"], start: Float64[np.ndarray, "S 3"], end: Float64[np.ndarray, "S 3"]
) -> Float64[np.ndarray, "n S"]:
    """Distance of each point from each line segment [m]."""
    along = end - start
    arm = points[:, None] - start
    share = np.einsum("nsi,si->ns", arm, along) / np.maximum((along**2).sum(axis=1), np.finfo(np.float64).tiny)
    return np.asarray(np.linalg.norm(arm - np.clip(share, 0, 1)[..., None] * along, axis=2))


def _nodes(system: ModalSystem, length_voxels: float) -> tuple[_Paths, _Nodes]:
    """Which node each voxel is of, and each node's parent; nodes in order of their distance from the root."""
    from scipy.sparse.csgraph import connected_components, dijkstra

    grid = system.grid
    edges = stand_graph(grid, system.tree).tocoo()
    unlike = unlikeness(system, edges.row, edges.col)
    way = unlikeness(system, edges.row, edges.col, strength_power=WAY_POWER, floor=WAY_FLOOR)
    length = edges.data * (1 + DETOUR * way)
    graph = scipy.sparse.csr_array((length, (edges.row, edges.col)), shape=(len(grid), len(grid)))
    roots = stand_roots(graph, grid, system.tree)
    distance, before, _ = dijkstra(graph, indices=np.concatenate(roots), min_only=True, return_predecessors=True)
    order = np.argsort(distance, kind="stable")
    paths = _Paths(order=order, before=before, length_m=_plain_length(grid.centres_m, order, before))
    ring = np.floor(paths.length_m / (length_voxels * grid.voxel_size_m)).astype(np.int64)
    together = (ring[edges.row] == ring[edges.col]) & (unlike < APART)
    same = scipy.sparse.csr_array(
        (np.ones(together.sum(), np.int8), (edges.row[together], edges.col[together])), shape=graph.shape
    )
    _, node = connected_components(same, directed=False)
    for foot in roots:
        node[foot] = node[foot[0]]  # a root is one node, whatever its shape
    parent = _parents(node.astype(np.int64), paths)
    return paths, _merge_small(node.astype(np.int64), parent, distance, smallest=SMALLEST_NODE * length_voxels)


def _plain_length(
    centres: Float32[np.ndarray, "V 3"], order: Int64[np.ndarray, " V"], before: Int32[np.ndarray, " V"]
) -> Float64[np.ndarray, " V"]:
    """Length in metres of each voxel's cheapest path, whose edges were weighed otherwise."""
    step = np.where(before < 0, 0, np.linalg.norm(centres - centres[np.maximum(before, 0)], axis=1))
    way = np.zeros(len(centres))
    for voxel in order:
        if before[voxel] >= 0:
            way[voxel] = way[before[voxel]] + step[voxel]
    return way


def _parents(node: Int64[np.ndarray, " V"], paths: _Paths) -> Int64[np.ndarray, " A"]:
    """The node from which a node's nearest voxel is reached: always nearer to the root, so there is no cycle."""
    parent = np.full(int(node.max()) + 1, -1, np.int64)
    first = paths.order[np.unique(node[paths.order], return_index=True)[1]]  # of each node, the nearest to the root
    reached = paths.before[first]
    present = node[first]
    parent[present[reached >= 0]] = node[reached[reached >= 0]]
    return parent


def _merge_small(
    node: Int64[np.ndarray, " V"], parent: Int64[np.ndarray, " A"], distance: np.ndarray, *, smallest: float
) -> _Nodes:
    """Give the voxels of small nodes to the nearest ancestor that is not, and number what remains from the root."""
    nearest = np.full(len(parent), np.inf)
    np.minimum.at(nearest, node, distance)
    size = np.bincount(node, minlength=len(parent))
    target = np.arange(len(parent))
    order = np.argsort(nearest, kind="stable")
    for this in order:
        if parent[this] >= 0 and size[this] < smallest:
            target[this] = target[parent[this]]
    roots = [this for this in order if target[this] == this and size[this] > 0]
    number = np.full(len(parent), -1, np.int64)
    number[roots] = np.arange(len(roots))
    above = parent[roots]
    numbered = np.where(above < 0, -1, number[target[above]])
    return _Nodes(of_voxel=number[target[node]], own=target[node] == node, parent=numbered.astype(np.int32))
