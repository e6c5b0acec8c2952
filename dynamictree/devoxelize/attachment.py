"""Find where small separate parts of a mesh, such as leaf cards, are attached to larger parts.

Files rarely connect a leaf with its twig: it is a separate part nearby. A part is attached at its point nearest to a
larger part, to the nearest point there; clearly larger parts are preferred, and twigs rather than cards. A separate
branch is attached where its end, or the end of its carrier, touches, also to a trunk that is no larger or consists of
several parts; otherwise where it crosses the tree. Parts far from the tree are not attached.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int32, Int64
from scipy.spatial import cKDTree

from dynamictree.mesh import Surface, connected_parts, part_bounds
from dynamictree.parallel import num_cores
from dynamictree.voxel.clip_kernel import SurfacePieces
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import surface_pieces

SMALL_PART_VOXELS = 8.0
"""Largest extent of an attached part [voxels]; the motion of larger parts is determined by their own voxels."""

FEW_VERTICES = 24
"""Parts with at most this many vertices are attached whatever their extent, as in low-poly crowns."""

CARD_VERTICES = 8
"""Parts with at most this many vertices are cards, attached to other parts if possible, and carriers of last resort."""

MAX_GAP_VOXELS = 2.0
"""Largest gap to a larger part; a part farther away moves by its own voxels."""

TWIG_GAP_VOXELS, TWIG_GAP_SHARE = 6.5, 0.65
"""The same for a card and a clearly larger twig, and as a share of the card's extent; artists leave gaps there."""

TOUCHING_VOXELS = 1.0
"""Largest gap at which the end of a separate branch touches another part."""

_NEAR_PIECES = (4, 32)  # numbers of nearest pieces; most parts find a larger one among the first few
_PIECES_AT_ONCE = 100_000
_CLEARLY_LARGER = 1.7
"""Ratio of extents of a preferred carrier, so that leaves are attached to twigs and not to each other."""
_CLASSES_PER_DOUBLING = 4  # classes of extents, each with a search tree of clearly larger parts
_AT_END = 0.3  # share of the extent; least distance of a branch's end from its middle
_NO_PAIRS = np.zeros((0, 2), np.int64)
_NOWHERE = np.zeros((0, 2, 3), np.int32), np.zeros((0, 2, 3), np.float32)


@dataclass(frozen=True, kw_only=True)
class Attachments:
    """Attachments of B parts to others."""

    part: Int32[np.ndarray, " N"]  # part of each vertex
    children: Int32[np.ndarray, " B"]  # attached parts
    corners: Int32[np.ndarray, "B 2 3"]  # vertices of a face of the part, and of the face that it is attached to
    weights: Float32[np.ndarray, "B 2 3"]  # barycentric coordinates in these faces


def find_attachments(mesh: Surface, grid: VoxelGrid) -> Attachments:
    """Find the attachments in a welded mesh; `grid` gives the unit of lengths."""
    part = connected_parts(mesh.faces, mesh.num_vertices)
    low, high = part_bounds(part, mesh.vertices)
    extent: Float64[np.ndarray, " parts"] = (high - low).max(axis=1) / grid.voxel_size_m
    if len(extent) == 1:
        return _attachments(mesh, part, None, _NO_PAIRS)
    num_vertices = np.bincount(part)
    small, few, card = extent < SMALL_PART_VOXELS, num_vertices <= FEW_VERTICES, num_vertices <= CARD_VERTICES
    stands = ~small & (low[:, 2] < low[:, 2].min() + grid.voxel_size_m)  # a trunk is never attached to its crown
    rank = np.argsort(np.lexsort((extent, ~card)))  # stems of any size carry cards
    pieces = surface_pieces(mesh, grid.origin_m, grid.voxel_size_m, grid.resolution)
    owner = part[mesh.faces[pieces.faces, 0]]
    places = np.einsum("pi,pic->pc", pieces.centroids, mesh.vertices[mesh.faces[pieces.faces]])
    surface = _Surface(places=places, owner=owner, extent=extent, voxel_size_m=grid.voxel_size_m)
    trunk, pairs = stands.copy(), [_NO_PAIRS]
    while True:  # a trunk may consist of parts that are shorter than the branches
        piled = surface.near_any_larger(~(trunk | small | card), trunk, trunk.astype(np.int64))
        on_end = surface.touches_at_end(piled) & surface.touches_at_end(piled[:, ::-1])
        octaves = np.diff(np.log2(surface.thickness_m[owner[piled]]), axis=1)[:, 0]
        piled = piled[on_end & (np.abs(octaves) < 1)]
        if len(piled) == 0:
            break
        pairs.append(piled)
        trunk[owner[piled[:, 0]]] = True
    loose = (small | few) & ~trunk
    on_larger = surface.near_larger(~trunk & ~card, ~card, MAX_GAP_VOXELS)
    pairs += [on_larger[loose[owner[on_larger[:, 0]]] | surface.touches_at_end(on_larger)]]
    seeking: Bool[np.ndarray, " parts"] = loose & (rank < len(extent) - 1)

    def left() -> Bool[np.ndarray, " parts"]:
        seeking[owner[pairs[-1][:, 0]]] = False
        return seeking

    pairs.append(surface.near_any_larger(left(), ~card, rank))  # a twig of about the same size
    pairs.append(surface.near_larger(left() & few, ~card, TWIG_GAP_VOXELS))
    pairs.append(surface.near_larger(left(), np.ones_like(card), MAX_GAP_VOXELS))
    pairs.append(surface.near_any_larger(left(), np.ones_like(card), rank))  # another card
    pairs.append(surface.near_larger(left() & few, np.ones_like(card), TWIG_GAP_VOXELS))
    pairs, carrier, goes_on = [_without_circles(np.concatenate(pairs), owner, card)], np.arange(len(extent)), True
    while goes_on:  # stems as large as their carrier, from the trunk outward
        carrier[owner[pairs[-1][:, 0]]] = owner[pairs[-1][:, 1]]
        root = carrier
        while (root[root] != root).any():
            root = root[root]
        rooted = (stands if stands.any() else extent == extent.max())[root]
        alone = ~(rooted | small | card) & (carrier == root)
        on_alike = surface.near_any_larger(alone, rooted & ~card, rooted.astype(np.int64))
        pairs.append(on_alike[surface.touches_at_end(on_alike) | surface.touches_at_end(on_alike[:, ::-1])])
        if len(pairs[-1]) == 0:  # a part that it crosses is better than none
            pairs[-1] = surface.near_any_larger(~rooted & (carrier == root), rooted, rooted.astype(np.int64))
        goes_on = len(pairs[-1]) > 0
    return _attachments(mesh, part, pieces, np.concatenate(pairs))


@dataclass(frozen=True, kw_only=True)
class _Surface:
    """Pieces of the surface of all parts."""

    places: Float32[np.ndarray, "P 3"]  # [m]
    owner: Int32[np.ndarray, " P"]  # part of each piece
    extent: Float64[np.ndarray, " parts"]  # [voxels]
    voxel_size_m: float

    def near_larger(
        self, seeking: Bool[np.ndarray, " parts"], allowed: Bool[np.ndarray, " parts"], gap_voxels: float
    ) -> Int64[np.ndarray, "B 2"]:
        """Pair each seeking part's nearest piece with the piece of an allowed, clearly larger part."""
        size_class = np.ceil(np.log2(np.maximum(self.extent, 1)) * _CLASSES_PER_DOUBLING).astype(np.int64)
        pairs = [_NO_PAIRS]
        for one in np.unique(size_class[seeking]):
            larger = allowed & (self.extent >= _CLEARLY_LARGER * 2.0 ** (one / _CLASSES_PER_DOUBLING))
            own, above = (np.flatnonzero(some[self.owner]) for some in (seeking & (size_class == one), larger))
            if len(above) and len(own):
                share = TWIG_GAP_SHARE * 2.0 ** (one / _CLASSES_PER_DOUBLING)
                reach_m = max(MAX_GAP_VOXELS, min(gap_voxels, share)) * self.voxel_size_m
                gap, nearest = _nearest(_tree(self.places[above]), self.places[own], reach_m=reach_m, count=1)
                best = _first_of_each(self.owner[own], gap[:, 0])
                pairs.append(np.stack([own[best], above[nearest[best, 0]]], axis=1))
        return np.concatenate(pairs)

    def near_any_larger(
        self,
        seeking: Bool[np.ndarray, " parts"],
        allowed: Bool[np.ndarray, " parts"],
        rank: Int64[np.ndarray, " parts"],
    ) -> Int64[np.ndarray, "B 2"]:
        """Pair each seeking part's nearest piece with the piece of an allowed part of higher rank."""
        own, above = (np.flatnonzero(some[self.owner]) for some in (seeking, allowed))
        if len(own) == 0 or len(above) == 0:
            return _NO_PAIRS
        reach_m = MAX_GAP_VOXELS * self.voxel_size_m
        tree = _tree(self.places[above])
        smallest, there = np.full(len(own), np.inf), np.zeros(len(own), np.int64)
        seeks = np.arange(len(own))
        for count in (min(pieces, len(above)) for pieces in _NEAR_PIECES):
            full = np.full(len(own), -1.0)  # gap to the last of `count` pieces, if there may be more
            for some in np.array_split(seeks, -(-len(seeks) // _PIECES_AT_ONCE) or 1):
                gap, nearest = _nearest(tree, self.places[own[some]], reach_m=reach_m, count=count)
                full[some] = np.where(np.isfinite(gap[:, -1]), gap[:, -1], -1)
                other = above[np.minimum(nearest, len(above) - 1)]
                gap = np.where(rank[self.owner[other]] > rank[self.owner[own[some]]][:, None], gap, np.inf)
                column = np.argmin(gap, axis=1)[:, None]
                smallest[some], there[some] = (np.take_along_axis(of, column, axis=1)[:, 0] for of in (gap, other))
            best_m = np.full(len(self.extent), np.inf)
            np.minimum.at(best_m, self.owner[own], smallest)
            # the others have no more pieces nearby, or their part has a nearer one
            seeks = np.flatnonzero((full >= 0) & np.isinf(smallest) & (full <= best_m[self.owner[own]]))
        best = _first_of_each(self.owner[own], smallest)
        return np.stack([own[best], there[best]], axis=1)

    def means(self, values: Float[np.ndarray, "P C"]) -> Float64[np.ndarray, "parts C"]:
        """Average values over the pieces of each part."""
        count = np.maximum(np.bincount(self.owner, minlength=len(self.extent)), 1)
        sums = [np.bincount(self.owner, column, len(self.extent)) for column in values.T]
        return np.asarray(np.stack(sums, axis=1) / count[:, None])

    @cached_property
    def thickness_m(self) -> Float64[np.ndarray, " parts"]:
        """Thickness of each part: root of its second principal moment."""
        away = self.places - self.means(self.places)[self.owner]
        moments = self.means(np.einsum("pi,pj->pij", away, away).reshape(-1, 9)).reshape(-1, 3, 3)
        return np.asarray(np.sqrt(np.linalg.eigvalsh(moments)[:, 1].clip(1e-18)))

    def touches_at_end(self, pairs: Int64[np.ndarray, "B 2"]) -> Bool[np.ndarray, " B"]:
        """Whether a part touches the other with its end, and not with its middle, as crossing branches do."""
        (own, other), part = self.places[pairs].transpose(1, 0, 2), self.owner[pairs[:, 0]]
        from_middle = np.linalg.norm(own - self.means(self.places)[part], axis=1) / self.voxel_size_m
        touches = np.linalg.norm(own - other, axis=1) <= TOUCHING_VOXELS * self.voxel_size_m
        return np.asarray(touches & (from_middle >= _AT_END * self.extent[part]))


def _without_circles(
    pairs: Int64[np.ndarray, "B 2"], owner: Int32[np.ndarray, " P"], card: Bool[np.ndarray, " parts"]
) -> Int64[np.ndarray, "_ 2"]:
    """Detach a part from the card that it carries itself, also indirectly: only cards are carried by smaller parts."""
    child, above = owner[pairs].T
    root, in_circle = np.arange(len(card)), np.zeros_like(card)
    root[child] = above
    for _ in range(len(card).bit_length()):  # as many steps as there are parts
        root = root[root]
    in_circle[root] = True
    return np.asarray(pairs[~((in_circle & ~card)[child] & card[above])])


def _tree(places: Float32[np.ndarray, "P 3"]) -> cKDTree:
    return cKDTree(places, balanced_tree=False, compact_nodes=False)  # quick to build, since there are few queries


def _nearest(
    tree: cKDTree, points: Float32[np.ndarray, "M 3"], *, reach_m: float, count: int
) -> tuple[Float64[np.ndarray, "M count"], Int64[np.ndarray, "M count"]]:
    """Return distances and rows of the places nearest to each point, nearest first; infinite if there are none."""
    matches = tree.query(points, k=np.arange(1, count + 1), distance_upper_bound=reach_m, workers=num_cores())
    return np.asarray(matches[0]), np.asarray(matches[1])


def _first_of_each(group: Int32[np.ndarray, " M"], gap: Float64[np.ndarray, " M"]) -> Int64[np.ndarray, " B"]:
    """Return the row of the smallest gap of each group; groups without a finite gap are left out."""
    order = np.lexsort((gap, group))
    first: Int64[np.ndarray, " B"] = order[np.unique(group[order], return_index=True)[1]]
    return np.asarray(first[np.isfinite(gap[first])])


def _attachments(
    mesh: Surface, part: Int32[np.ndarray, " N"], pieces: SurfacePieces | None, pairs: Int64[np.ndarray, "B 2"]
) -> Attachments:
    corners, weights = (mesh.faces[pieces.faces[pairs]], pieces.centroids[pairs]) if pieces else _NOWHERE
    return Attachments(part=part, children=part[corners[:, 0, 0]], corners=corners, weights=weights)
