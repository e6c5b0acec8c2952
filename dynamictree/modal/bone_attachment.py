"""From bones to a mesh: which bones carry each vertex."""

from dataclasses import dataclass

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Float32, Int32

from dynamictree.mesh import TriangleMesh, connected_parts, edges_of, part_bounds
from dynamictree.modal.bones import Bones

BONES_A_VERTEX = 6
STIFF_VOXELS = 12.0  # a part of the mesh that is smaller moves as one: a leaf keeps its shape
SPREAD = 80  # edges over which a vertex shares its bones; a part then follows its own stem, not what touches it
LONG_VOXELS = 2.0  # edges that are longer share less, so that a coarse trunk does not share its crown's bones


@dataclass(frozen=True, kw_only=True)
class BoneAttachment:
    """Each vertex' bones and their weights, which sum to 1, or are all 0 where it stands still."""

    rows: Int32[np.ndarray, "N W"]
    weights: Float32[np.ndarray, "N W"]


def attach_mesh(
    bones: Bones,
    mesh: TriangleMesh,
    *,
    rows: Int32[np.ndarray, "N M"],
    weights: Float32[np.ndarray, "N M"],
    voxel_size_m: float,
) -> BoneAttachment:
    """Give each vertex the bones of its voxels (`rows` and `weights`), spread along the edges of what may move."""
    mesh = mesh.moving_part
    num_vertices, width = rows.shape
    points = np.repeat(np.arange(num_vertices), width)
    shape = (num_vertices, len(bones.parent))
    carried = scipy.sparse.csr_array((weights.ravel(), (points, bones.bone_of_voxel[rows.ravel()])), shape=shape)
    graph = _shared(mesh, LONG_VOXELS * voxel_size_m)
    spread = scipy.sparse.diags_array(1 / graph.sum(axis=1)) @ graph
    carried = _stiffen(carried, mesh, STIFF_VOXELS * voxel_size_m)
    for _ in range(SPREAD):
        carried = spread @ carried
    return _strongest(carried.tocsr())


def _shared(mesh: TriangleMesh, long_m: float) -> "scipy.sparse.csr_array":
    """How much neighbours share: 1 with themselves and over short edges, (long / length)² over longer ones [N, N].

    So in n steps they share over sqrt(n) times `long_m`, however long the edges are.
    """
    start, end = edges_of(mesh.faces).T
    length = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
    share = (long_m / np.maximum(length, long_m)) ** 2
    loops = np.arange(mesh.num_vertices)
    pairs = (np.concatenate([start, end, loops]), np.concatenate([end, start, loops]))
    values = np.concatenate([share, share, np.ones(len(loops))]).astype(np.float32)
    return scipy.sparse.csr_array((values, pairs), shape=(len(loops), len(loops)))


def _stiffen(carried: "scipy.sparse.csr_array", mesh: TriangleMesh, size_m: float) -> "scipy.sparse.csr_array":
    """One mean for all vertices of a connected part that is small."""
    part = connected_parts(mesh.faces, mesh.num_vertices)
    low, high = part_bounds(part, mesh.vertices)
    small = ((high - low).max(axis=1) < size_m)[part]  # [N]
    every = np.arange(len(part))
    member = scipy.sparse.csr_array((np.ones(small.sum()), (every[small], part[small])), shape=(len(part), len(low)))
    mean = scipy.sparse.diags_array(1 / np.maximum(member.sum(axis=0), 1)) @ (member.T @ carried)
    large_parts = scipy.sparse.diags_array((~small).astype(np.float64)) @ carried
    together: scipy.sparse.csr_array = (member @ mean + large_parts).tocsr()
    return together


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
