"""From bones to a mesh: which bones carry each vertex."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Bool, Float32, Float64, Int32, Int64

from dynamictree.mesh import Surface, edges_of, part_bounds
from dynamictree.modal.bones import Bones

if TYPE_CHECKING:
    from dynamictree.devoxelize.attachment import Attachments  # brings numba
    from dynamictree.devoxelize.shares import VoxelShares  # likewise

BONES_A_VERTEX = 6
STIFF_VOXELS = 12.0  # a part of the mesh that is smaller has one bone: a leaf keeps its shape
TRUNK_VOXELS = 24.0  # but for one that carries more than a twig does: a trunk may consist of short pieces
STEM_SHARE = 0.3  # of a part that one chain of bones carries: it is a stem, and has no bones of others
SPREAD = 80  # edges over which a vertex shares its bones; a part then follows its own stem, not what touches it
LONG_VOXELS = 0.4  # edges that are longer share less: in 80 steps, bones blend over 4 voxels and not over a whole twig


@dataclass(frozen=True, kw_only=True)
class BoneAttachment:
    """Each vertex' bones and their weights, which sum to 1, or are all 0 where it stands still."""

    rows: Int32[np.ndarray, "N W"]
    weights: Float32[np.ndarray, "N W"]


def attach_mesh(
    bones: Bones, mesh: Surface, ties: "VoxelShares", *, voxel_size_m: float, parts_hang: bool = True
) -> BoneAttachment:
    """Give each vertex the bones of its voxels, spread along the edges of what may move.

    A stem shares voxels with what it touches, so it keeps only the bones of its own chain; what is small has the
    strongest bone of the place where it hangs. Vertices at one position have the same bones.

    Args:
        bones: of the grid's voxels.
        mesh: at rest.
        ties: of this mesh and grid.
        voxel_size_m: of the grid.
        parts_hang: if not, what is small has its own strongest bone, so that a twig's joint carries the twig.
    """
    vertex, part = ties.welded, ties.attachments.part  # of the welded mesh
    sample = np.zeros(len(part), np.int64)  # one of the vertices at a place, a moving one if there is any
    order = np.argsort(ties.weights.any(axis=1), kind="stable")
    sample[vertex[order]] = order
    points = mesh.vertices[sample]
    low, high = part_bounds(part, points)
    carried_low, carried_high = _with_what_hangs(low, high, ties.attachments)
    small = (high - low).max(axis=1) < STIFF_VOXELS * voxel_size_m
    small &= (carried_high - carried_low).max(axis=1) < TRUNK_VOXELS * voxel_size_m
    member = _matrix(np.ones(len(part)), np.arange(len(part)), part, (len(part), len(small)))
    rows, weights = ties.rows[sample], ties.weights[sample]
    own = np.repeat(np.arange(len(part)), rows.shape[1])
    carried = _matrix(weights.ravel(), own, bones.bone_of_voxel[rows.ravel()], (len(part), len(bones.parent)))
    start, end = edges_of(vertex[mesh.moving_part.faces]).T
    graph = _shared(points, start[start != end], end[start != end], LONG_VOXELS * voxel_size_m)
    carried = _filled(_along_stems(carried, member, bones.parent, ~small), graph)
    for _ in range(SPREAD):
        carried = graph @ carried
    bone_of_part: Int64[np.ndarray, " parts"] = np.asarray((member.T @ carried).argmax(axis=1)).ravel()
    if parts_hang:
        bone_of_part = _where_parts_hang(bone_of_part, carried, ties.attachments, small)
    single = np.flatnonzero(small[part] & (carried.sum(axis=1) > 0))
    carried = scipy.sparse.diags_array((~small[part]).astype(np.float64)) @ carried
    carried += _matrix(np.ones(len(single)), single, bone_of_part[part[single]], carried.shape)
    strongest = _strongest(carried.tocsr())
    moving = ties.weights.any(axis=1, keepdims=True)
    return BoneAttachment(rows=strongest.rows[vertex], weights=np.where(moving, strongest.weights[vertex], 0))


def _with_what_hangs(
    low: Float64[np.ndarray, "parts 3"], high: Float64[np.ndarray, "parts 3"], attachments: "Attachments"
) -> tuple[Float64[np.ndarray, "parts 3"], Float64[np.ndarray, "parts 3"]]:
    """Bounds of each part together with all that hangs on it."""
    children, on = attachments.children, attachments.part[attachments.corners[:, 1, 0]]
    while True:
        lower, higher = low.copy(), high.copy()
        np.minimum.at(lower, on, low[children])
        np.maximum.at(higher, on, high[children])
        if np.array_equal(lower, low) and np.array_equal(higher, high):
            return low, high
        low, high = lower, higher


def _matrix(
    values: np.ndarray, row: np.ndarray, column: np.ndarray, shape: tuple[int, int]
) -> "scipy.sparse.csr_array":
    return scipy.sparse.csr_array((values, (row, column)), shape=shape)


def _shared(
    points: Float32[np.ndarray, "n 3"], start: Int32[np.ndarray, " E"], end: Int32[np.ndarray, " E"], long_m: float
) -> "scipy.sparse.csr_array":
    """How much neighbours share: 1 with themselves and over short edges, (long / length)² over longer ones [n, n].

    Rows sum to 1. So in k steps they share over sqrt(k) times `long_m`, however long the edges are.
    """
    length = np.linalg.norm(points[start] - points[end], axis=1)
    share = (long_m / np.maximum(length, long_m)) ** 2
    loops = np.arange(len(points))
    rows, columns = np.concatenate([start, end, loops]), np.concatenate([end, start, loops])
    graph = _matrix(np.concatenate([share, share, np.ones(len(loops))]), rows, columns, (len(points),) * 2)
    to_one: scipy.sparse.csr_array = (scipy.sparse.diags_array(1 / graph.sum(axis=1)) @ graph).tocsr()
    return to_one


def _along_stems(
    carried: "scipy.sparse.csr_array",
    member: "scipy.sparse.csr_array",
    parent: Int32[np.ndarray, " B"],
    large: Bool[np.ndarray, " parts"],
) -> "scipy.sparse.csr_array":
    """Leave stems the bones between the root and one other bone, the one with which most of the stem stays carried."""
    stems = np.flatnonzero(large)
    along = (member.T @ carried)[stems].toarray()  # [S, B]
    total = along.sum(axis=1)
    line = np.eye(len(parent), dtype=bool)  # of each bone, itself and its ancestors
    for bone, above in enumerate(parent):
        if above >= 0:  # parents come before children
            along[:, bone] += along[:, above]
            line[bone] |= line[above]
    allowed = np.ones((len(large), len(parent)), bool)
    is_stem = along.max(axis=1, initial=0) >= STEM_SHARE * total
    allowed[stems[is_stem]] = line[along[is_stem].argmax(axis=1)]
    entries = carried.tocoo()
    part = member.indices  # one entry a row
    chosen = allowed[part[entries.row], entries.col]
    return _matrix(entries.data[chosen], entries.row[chosen], entries.col[chosen], carried.shape)


def _filled(carried: "scipy.sparse.csr_array", graph: "scipy.sparse.csr_array") -> "scipy.sparse.csr_array":
    """Give vertices that have no bone those of their neighbours, ring after ring."""
    while True:
        empty = np.flatnonzero(carried.sum(axis=1) == 0)
        near = graph[empty] @ carried
        reached = near.sum(axis=1) > 0
        if not reached.any():
            return carried
        into = _matrix(
            1 / near.sum(axis=1)[reached], empty[reached], np.flatnonzero(reached), (len(graph.indptr) - 1, len(empty))
        )
        carried = carried + into @ near


def _where_parts_hang(
    strongest: Int64[np.ndarray, " parts"],
    carried: "scipy.sparse.csr_array",
    attachments: "Attachments",
    small: Bool[np.ndarray, " parts"],
) -> Int64[np.ndarray, " parts"]:
    """The bone of the place where each small part hangs; the strongest bone of the others."""
    bone = strongest.copy()
    hangs = small[attachments.children]
    children, corners = attachments.children[hangs], attachments.corners[hangs, 1]
    place = np.repeat(np.arange(len(children)), 3)
    there = _matrix(attachments.weights[hangs, 1].ravel(), place, corners.ravel(), (len(children), carried.shape[0]))
    at_place = np.asarray((there @ carried).argmax(axis=1)).ravel()
    on = attachments.part[corners[:, 0]]
    while True:  # a part may hang on one that hangs
        carrier = np.where(small[on], bone[on], at_place)
        if np.array_equal(bone[children], carrier):
            return bone
        bone[children] = carrier


def _strongest(carried: "scipy.sparse.csr_array") -> BoneAttachment:
    num_vertices = carried.shape[0]
    point = np.repeat(np.arange(num_vertices), np.diff(carried.indptr))
    order = np.lexsort((carried.indices, -carried.data, point))
    rank = np.arange(len(point)) - carried.indptr[point]
    strongest = rank < BONES_A_VERTEX
    rows = np.zeros((num_vertices, BONES_A_VERTEX), np.int32)
    weights = np.zeros((num_vertices, BONES_A_VERTEX), np.float32)
    rows[point[strongest], rank[strongest]] = carried.indices[order][strongest]
    weights[point[strongest], rank[strongest]] = carried.data[order][strongest]
    total = weights.sum(axis=1, keepdims=True)
    return BoneAttachment(rows=rows, weights=weights / np.where(total > 0, total, 1))
