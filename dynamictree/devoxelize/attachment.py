"""Find where small separate parts of a mesh, such as leaf cards, are attached to larger parts.

Files rarely join a leaf to its twig: it is a part of its own that only comes near. A part hangs by its point that is
nearest to a larger part, on the nearest point there. Parts that are far from anything larger hang on nothing.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Float32, Float64, Int32, Int64
from scipy.spatial import cKDTree

from dynamictree.mesh import TriangleMesh, connected_parts, part_bounds
from dynamictree.parallel import num_cores
from dynamictree.voxel.clip import SurfacePieces
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import grid_pieces

SMALL_PART_VOXELS = 8.0
"""Largest extent of a part that hangs on another, in voxels. The voxels of a larger one say how it moves."""

FEW_VERTICES = 24
"""A part with no more is a card, which hangs on another whatever its extent: low-poly crowns are made of large ones."""

MAX_GAP_VOXELS = 2.0
"""Farther from any larger part, a part moves by its own voxels; nearer ones may share voxels with it."""

_NEAR_PIECES = 32
_CLEARLY_LARGER = 2.0
"""A part hangs on one that is this much larger if one is near, so that leaves hang on twigs and not on each other."""


@dataclass(frozen=True, kw_only=True)
class Attachments:
    """B parts that are attached to others."""

    part: Int32[np.ndarray, " N"]  # of each vertex
    children: Int32[np.ndarray, " B"]  # the parts that hang
    corners: Int32[np.ndarray, "B 2 3"]  # by which face of theirs, on which face of the other part
    weights: Float32[np.ndarray, "B 2 3"]  # and where in these, barycentric

    def __len__(self) -> int:
        return len(self.children)

    def differences(self) -> "scipy.sparse.csr_array":
        """Rows that take the value where a part hangs from the value of its own point there [B, N]."""
        values = self.weights.astype(np.float64) * np.array([[1], [-1]])
        ends, shape = 6 * np.arange(len(self) + 1), (len(self), len(self.part))
        return scipy.sparse.csr_array((values.ravel(), self.corners.ravel(), ends), shape=shape)

    def closed(self, motion: Complex64[np.ndarray, "N K 3"]) -> Complex64[np.ndarray, "N K 3"]:
        """Shift every attached part so that its gap to the attachment point stays as at rest."""
        if len(self) == 0:
            return motion
        num_parts = int(self.part.max()) + 1
        shift = np.zeros((num_parts, *motion.shape[1:]), np.complex64)
        parent = self.part[self.corners[:, 1, 0]]
        points = np.einsum("bsi,bsikc->bskc", self.weights, motion[self.corners])  # [B, 2, K, 3]
        own = points[:, 1] - points[:, 0]
        depth = _depths(self.children, parent, num_parts)
        for level in range(1, int(depth.max()) + 1):  # a parent's shift is complete before its children's
            level_rows = np.flatnonzero(depth == level)
            shift[self.children[level_rows]] = own[level_rows] + shift[parent[level_rows]]
        closed: Complex64[np.ndarray, "N K 3"] = motion + shift[self.part]
        return closed


def _depths(
    children: Int32[np.ndarray, " B"], parent: Int32[np.ndarray, " B"], num_parts: int
) -> Int64[np.ndarray, " B"]:
    """Attachment depth of each part: 1 if its parent is not attached to anything, one more per step."""
    depth_of = np.zeros(num_parts, np.int64)
    while True:
        depth = depth_of[parent] + 1
        if np.array_equal(depth, depth_of[children]):
            break
        depth_of[children] = depth
    result: Int64[np.ndarray, " B"] = depth
    return result


def find_attachments(mesh: TriangleMesh, grid: VoxelGrid, pieces: SurfacePieces | None = None) -> Attachments:
    """Find the attachments in a welded mesh and its grid; `pieces` are those of both, if they are there."""
    part = connected_parts(mesh.faces, mesh.num_vertices)
    low, high = part_bounds(part, mesh.vertices)
    extent: Float64[np.ndarray, " parts"] = (high - low).max(axis=1) / grid.voxel_size_m
    size_class = np.floor(np.log(np.maximum(extent, 1e-3)) / np.log(_CLEARLY_LARGER)).astype(np.int64)
    rank = np.empty(len(extent), np.int64)
    rank[np.argsort(extent, kind="stable")] = np.arange(len(extent))
    coarse = np.bincount(part) <= FEW_VERTICES
    seeking = ((extent < SMALL_PART_VOXELS) | coarse) & (rank < len(extent) - 1)
    if not seeking.any():
        nothing = np.zeros((0, 2), np.int64)
        return _attachments(mesh, part, nothing.astype(np.int32), np.zeros((0, 2, 3), np.float32))
    pieces = pieces or grid_pieces(mesh, grid)
    owner = part[mesh.faces[pieces.faces, 0]]
    places = np.einsum("pi,pic->pc", pieces.centroids, mesh.vertices[mesh.faces[pieces.faces]])
    reach = MAX_GAP_VOXELS * grid.voxel_size_m
    pairs = [np.zeros((0, 2), np.int64)]  # of pieces
    for one in np.unique(size_class[seeking]):
        own, above = np.flatnonzero((seeking & (size_class == one))[owner]), np.flatnonzero(size_class[owner] > one)
        if len(above) and len(own):
            gap, nearest = _near(places[above], places[own], reach_m=reach, count=1)
            best = _first_of_each(owner[own], gap[:, 0])
            pairs.append(np.stack([own[best], above[nearest[best, 0]]], axis=1))
    seeking[owner[np.concatenate(pairs)[:, 0]]] = False
    own = np.flatnonzero(seeking[owner])
    if len(own):  # only parts of about their own size are near
        gap, nearest = _near(places, places[own], reach_m=reach, count=min(_NEAR_PIECES, len(places)))
        larger = rank[owner[np.minimum(nearest, len(places) - 1)]] > rank[owner[own]][:, None]
        gap = np.where(larger, gap, np.inf)
        column = np.argmin(gap, axis=1)
        best = _first_of_each(owner[own], gap[np.arange(len(own)), column])
        pairs.append(np.stack([own[best], nearest[best, column[best]]], axis=1))
    chosen = np.concatenate(pairs)
    return _attachments(mesh, part, pieces.faces[chosen], pieces.centroids[chosen])


def _near(
    places: Float32[np.ndarray, "P 3"], points: Float32[np.ndarray, "M 3"], *, reach_m: float, count: int
) -> tuple[Float64[np.ndarray, "M count"], Int64[np.ndarray, "M count"]]:
    """Distance and row of the nearest places to each point, nearest first; infinite and P where there is none."""
    tree = cKDTree(places, balanced_tree=False, compact_nodes=False)  # few queries: quick to build
    matches = tree.query(points, k=np.arange(1, count + 1), distance_upper_bound=reach_m, workers=num_cores())
    return np.asarray(matches[0]), np.asarray(matches[1])


def _first_of_each(group: Int32[np.ndarray, " M"], gap: Float64[np.ndarray, " M"]) -> Int64[np.ndarray, " B"]:
    """Row of the smallest gap of each group; groups without any are left out."""
    order = np.lexsort((gap, group))
    first: Int64[np.ndarray, " B"] = order[np.unique(group[order], return_index=True)[1]]
    near: Int64[np.ndarray, " B"] = first[np.isfinite(gap[first])]
    return near


def _attachments(
    mesh: TriangleMesh,
    part: Int32[np.ndarray, " N"],
    faces: Int32[np.ndarray, "B 2"],
    weights: Float32[np.ndarray, "B 2 3"],
) -> Attachments:
    corners = mesh.faces[faces]  # [B, 2, 3]
    return Attachments(part=part, children=part[corners[:, 0, 0]], corners=corners, weights=weights)
