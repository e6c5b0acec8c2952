"""Build a skeleton of a mesh with bones that only rotate: pieces of stems, and a bone for each leaf card.

A bending part of the mesh is cut where the path along its surface from its foot is a whole number of bone lengths. The
connected vertices between two cuts are a node; a bone leads from the centre of the previous node to its centre. A card,
or another small part, is one bone. The first bone of a part starts where the part is attached to another, which carries
it; that of a trunk starts on the ground.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float64, Int32, Int64
from scipy.sparse.csgraph import connected_components, dijkstra

from dynamictree.devoxelize.attachment import CARD_VERTICES, SMALL_PART_VOXELS, Attachments, find_attachments
from dynamictree.mesh import Surface, edges_of, part_bounds, weld
from dynamictree.rig.pose import GROUND, Skeleton, Weights, by_depth
from dynamictree.voxel.grid import VoxelGrid

FINENESS = 128
"""Voxels along the tree, as the unit of bone lengths and small parts, independent of the motion's grid."""
BONE_VOXELS = 2.0
SMALLEST_NODE, NEAR_VOXELS = 3, 6.0
"""A node with fewer vertices, this near to its parent, is merged with it."""
WIDE_VOXELS, PATCH_VOXELS = 8.0, 4.0
"""A wider node, as in a crown that is one surface, is cut into patches."""
THIN = 0.05
"""A thinner node [bone length] moves rigidly with its bone. Blended, a twig's ring collapses between bones of very
different rotation; moved rigidly, edges to the next ring grow with its radius (docs/decisions/modal.md)."""


@dataclass(frozen=True, kw_only=True)
class _Parts:
    """P connected parts of a welded surface of n vertices."""

    of: Int64[np.ndarray, " n"]
    is_card: Bool[np.ndarray, " P"]
    stands: Bool[np.ndarray, " P"]
    above: Int64[np.ndarray, "P 3"]  # corners of the face that carries a part: the nearest, and distant ones; or -1
    foot_m: Float64[np.ndarray, "P 3"]
    begins: Bool[np.ndarray, " n"]  # vertices where a bending part starts


@dataclass(frozen=True, kw_only=True)
class SurfaceBones:
    """Bones of a mesh, the two that carry each of its N vertices, and a mask of the vertices of rigid cards."""

    skeleton: Skeleton
    vertices: Weights
    in_card: Bool[np.ndarray, " N"]


def surface_bones(mesh: Surface, grid: VoxelGrid) -> SurfaceBones:
    """Build the bones of a mesh of one tree; `grid` is that of its motion."""
    surface, vertex = weld(mesh.moving_part)
    surface, attached, row = _without_loose_vertices(surface, find_attachments(surface, grid))
    vertex = row[vertex]
    places = surface.vertices.astype(np.float64)
    voxel_m = float(np.ptp(places, axis=0).max()) / FINENESS
    parts = _parts_of(surface, attached, voxel_m)
    node, parent, first, is_surface = _nodes(surface, parts, voxel_m)
    part = parts.of[first]
    is_base = parent < 0
    centre = _means(node, places, len(parent))
    foot = np.where(is_base[:, None], parts.foot_m[part], centre[parent])
    bone, share = _carriers(places, node, parent, foot, centre - foot)
    hangs = is_base & (parts.above[part, 0] >= 0)
    standing = is_base & parts.stands[part]
    hinged = parts.is_card[part] & is_base & ~standing  # rotates independently from its foot on
    share[hinged[bone] & (share <= 0.5)] = 0
    share[is_base[bone] & ~hinged[bone]] *= 2  # a branch's foot is fixed in the bark, a trunk's in the ground

    above = parts.above[part[hangs]].T  # a face between two nodes belongs to the second one's bone
    carrier, b, c = np.where((share[above] > 0.5) & (parent[bone[above]] >= 0), parent[bone[above]], bone[above])
    parent[hangs] = np.where(parent[b] == carrier, b, np.where(parent[c] == carrier, c, carrier))
    floating = np.flatnonzero(is_base & ~hangs & ~standing)
    ground = places[places[:, 2] <= places[:, 2].min() + voxel_m].mean(axis=0)
    num_nodes, num_floating = len(parent), len(floating)
    # append a bone from the ground to the foot of each floating part, and the ground itself
    parent[standing] = num_nodes + num_floating
    parent[floating] = num_nodes + np.arange(num_floating)
    parent = np.concatenate([parent, np.full(num_floating, num_nodes + num_floating), [-1]])
    reach = np.concatenate([centre - foot, foot[floating] - ground, [[0, 0, voxel_m]]])
    foot = np.concatenate([foot, np.tile(ground, (num_floating + 1, 1))])
    in_surface = np.concatenate([is_surface[part], np.zeros(num_floating + 1, bool)])

    skeleton, order = by_depth(
        Skeleton(
            parent=parent.astype(np.int32),
            foot_m=foot.astype(np.float32),
            reach_m=reach.astype(np.float32),
            in_surface=in_surface,
        )
    )
    still = mesh.still_vertices | (vertex < 0)
    own = np.where(still, GROUND, np.argsort(order)[bone][vertex]).astype(np.int32)
    of_parent = np.where(still, 0, np.rint(255 * share[vertex]) / 255).astype(np.float32)  # stored in a byte
    return SurfaceBones(
        skeleton=skeleton,
        vertices=Weights(
            rows=np.stack([own, skeleton.above[own]], axis=1), shares=np.stack([1 - of_parent, of_parent], axis=1)
        ),
        in_card=parts.is_card[parts.of][vertex] & ~still,
    )


def _without_loose_vertices(
    surface: Surface, attached: Attachments
) -> tuple[Surface, Attachments, Int64[np.ndarray, " n"]]:
    """Remove vertices without faces, such as those of a pot; return each vertex's new row too, -1 if removed."""
    used = np.unique(surface.faces)
    row = np.full(surface.num_vertices, -1, np.int64)
    row[used] = np.arange(len(used))
    parts, part = np.unique(attached.part[used], return_inverse=True)
    attached = replace(
        attached,
        part=part.ravel().astype(np.int32),
        children=np.searchsorted(parts, attached.children).astype(np.int32),
        corners=row[attached.corners].astype(np.int32),
    )
    faces = row[surface.faces].astype(np.int32)
    return Surface(vertices=surface.vertices[used], faces=faces), attached, row


def _parts_of(surface: Surface, attached: Attachments, voxel_m: float) -> _Parts:
    of = attached.part.astype(np.int64)
    low, high = part_bounds(of, surface.vertices)
    small = (high - low).max(axis=1) < SMALL_PART_VOXELS * voxel_m
    stands = ~small & (low[:, 2] < low[:, 2].min() + voxel_m)
    extent = (high - low).max(axis=1)
    extent[attached.children] = 0
    stands[extent.argmax()] = True  # the trunk, even if leaves hang lower than its foot
    is_card = (small | (np.bincount(of) <= CARD_VERTICES)) & ~stands
    near_foot = surface.vertices[:, 2] <= low[of, 2] + voxel_m
    foot = _means(of[near_foot], surface.vertices[near_foot].astype(np.float64), len(low))
    own, other = attached.corners[:, 0], attached.corners[:, 1]
    foot[attached.children] = np.einsum("bi,bic->bc", attached.weights[:, 0], surface.vertices[own])
    above = np.full((len(low), 3), -1, np.int64)
    corners = np.take_along_axis(other, np.argsort(-attached.weights[:, 1], axis=1), axis=1)
    apart_m = np.linalg.norm(surface.vertices[corners] - surface.vertices[corners[:, :1]], axis=2)
    above[attached.children] = np.where(apart_m > 2 * NEAR_VOXELS * voxel_m, corners, corners[:, :1])
    begins = near_foot & (above[of, 0] < 0)
    begins[np.take_along_axis(own, attached.weights[:, 0].argmax(axis=1)[:, None], axis=1)] = True
    return _Parts(of=of, is_card=is_card, stands=stands, above=above, foot_m=foot, begins=begins & ~is_card[of])


def _nodes(
    surface: Surface, parts: _Parts, voxel_m: float
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " B"], Int64[np.ndarray, " B"], Bool[np.ndarray, " P"]]:
    """Return each vertex's node; each node's predecessor in its part, or -1, and its vertex nearest to the foot.

    The last value is a mask of the parts with nodes that were cut into patches.
    """
    places, count = surface.vertices.astype(np.float64), surface.num_vertices
    bends = ~parts.is_card[parts.of]
    edges = edges_of(surface.faces)
    edges = edges[bends[edges[:, 0]]]
    start, end = edges.T
    way, before = np.zeros(count), np.full(count, -1, np.int64)
    if parts.begins.any():
        length = np.linalg.norm(places[start] - places[end], axis=1)
        graph = scipy.sparse.csr_array((length, (start, end)), shape=(count, count))
        ways = dijkstra(
            graph, directed=False, indices=np.flatnonzero(parts.begins), min_only=True, return_predecessors=True
        )
        way, before = np.where(bends, ways[0], 0), np.where(bends, ways[1], -1)
    ring = np.floor(way / (BONE_VOXELS * voxel_m)).astype(np.int64)
    together = ring[start] == ring[end]
    node = _connected(edges[together], count)
    low, high = part_bounds(node, surface.vertices)
    wide = ((high - low).max(axis=1) > WIDE_VOXELS * voxel_m)[node]
    patch = np.where(wide[:, None], np.floor(places / (PATCH_VOXELS * voxel_m)), 0)
    node = _connected(edges[together & (patch[start] == patch[end]).all(axis=1)], count).astype(np.int64)
    base = (ring == 0) | ~bends
    node = np.unique(np.where(base, count + parts.of, node), return_inverse=True)[1].ravel()

    first = _first_of_each(node, way)
    parent = np.where(base[first], -1, node[np.maximum(before[first], 0)])
    size, centre = np.bincount(node), _means(node, places, len(first))
    near = np.linalg.norm(centre - centre[parent], axis=1) < NEAR_VOXELS * voxel_m
    target = np.arange(len(first))
    for this in np.argsort(way[first], kind="stable"):
        if parent[this] >= 0 and size[this] < SMALLEST_NODE and near[this]:
            target[this] = target[parent[this]]
    remaining = np.flatnonzero(target == np.arange(len(first)))
    number = np.zeros(len(first), np.int64)
    number[remaining] = np.arange(len(remaining))
    parent = np.where(parent[remaining] < 0, -1, number[target[parent[remaining]]])
    is_surface = np.bincount(parts.of, wide, len(parts.stands)) > 0
    return number[target[node]], parent, first[remaining], is_surface


def _carriers(
    places: Float64[np.ndarray, "n 3"],
    node: Int64[np.ndarray, " n"],
    parent: Int64[np.ndarray, " B"],
    foot: Float64[np.ndarray, "B 3"],
    reach: Float64[np.ndarray, "B 3"],
) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Return each vertex's bone and its parent's share: 1/2 at the foot of a bone, 0 beyond its middle.

    Beyond the middle, a vertex belongs to the next bone, and the share falls from 1 to 1/2; not for thin nodes.
    """

    def along(bone: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        arm = places - foot[bone]
        return np.asarray((arm * reach[bone]).sum(axis=1) / np.maximum((reach[bone] ** 2).sum(axis=1), 1e-12))

    own = along(node)
    after, best, share_there = np.full(len(places), -1), np.full(len(places), np.inf), np.zeros(len(places))
    children = np.flatnonzero(parent >= 0)
    children = children[np.argsort(parent[children], kind="stable")]
    rank = np.arange(len(children)) - np.searchsorted(parent[children], parent[children])
    for turn in range(int(rank.max()) + 1 if len(rank) else 0):  # nearest of the bones that start at the node
        child = np.full(len(parent), -1)
        child[parent[children[rank == turn]]] = children[rank == turn]
        rows = np.flatnonzero(child[node] >= 0)
        candidate = child[node[rows]]
        there = along(np.where(child[node] >= 0, child[node], 0))[rows]
        nearest = foot[candidate] + np.clip(there, 0, 1)[:, None] * reach[candidate]
        distance = np.linalg.norm(places[rows] - nearest, axis=1)
        better = distance < best[rows]
        after[rows[better]], best[rows[better]] = candidate[better], distance[better]
        share_there[rows[better]] = there[better]
    beyond = (after >= 0) & (share_there > 0) & (own > 1)
    towards = (after >= 0) & ~beyond & (own > 0.5)
    bone = np.where(beyond | towards, after, node)
    share = np.where(towards, np.clip(1.5 - own, 0.5, 1), np.clip(0.5 - np.where(beyond, share_there, own), 0, 0.5))
    width = np.zeros(len(parent))
    np.maximum.at(width, node, np.linalg.norm(places - (foot + reach)[node], axis=1))
    thin = (width < THIN * np.linalg.norm(reach, axis=1))[node]
    return np.where(thin, node, bone), np.where(thin, 0, share)


def _connected(edges: Int32[np.ndarray, "E 2"], count: int) -> Int32[np.ndarray, " n"]:
    joined = scipy.sparse.coo_array((np.ones(len(edges), np.int8), edges.T), shape=(count, count))
    return np.asarray(connected_components(joined, directed=False)[1], np.int32)


def _first_of_each(group: Int64[np.ndarray, " n"], way: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " B"]:
    order = np.argsort(way, kind="stable")
    first: Int64[np.ndarray, " B"] = order[np.unique(group[order], return_index=True)[1]]
    return first


def _means(
    group: Int64[np.ndarray, " n"], places: Float64[np.ndarray, "n 3"], count: int
) -> Float64[np.ndarray, "B 3"]:
    total = np.stack([np.bincount(group, column, count) for column in places.T], axis=1)
    return np.asarray(total / np.maximum(np.bincount(group, minlength=count), 1)[:, None])
