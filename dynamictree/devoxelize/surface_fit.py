"""Least-squares fit of a smooth motion of the surface to values at voxels.

The fit minimises, over the values x at the vertices,

    Σ_v |mean of x over the surface in v - c_v|²  +  λ Σ_ij (h / l_ij)² |x_i - x_j|²

with v the voxels, of edge h, and ij the edges of the mesh, of length l_ij. A small part of the mesh, such as a leaf
card, is connected to the point of a larger part where it hangs (`attachment.py`), as if by a short edge. So a thin ring
of vertices moves as one, values along a twig are interpolated, and surface that only passes close by has no influence,
even where it lies in the same voxel.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float32, Int32, Int64

from dynamictree.devoxelize.attachment import Attachments
from dynamictree.devoxelize.symmetric_factor import SymmetricFactor, factored
from dynamictree.mesh import Surface, edges_of
from dynamictree.voxel.grid import VoxelGrid

SMOOTHNESS = 0.03
"""λ, chosen on Sapling's and our own trees at 128³ (docs/decisions/core.md): less follows noise, more drags."""

MAX_NODES = 40_000
"""Largest number of unknowns. Larger meshes are solved on clusters of vertices, which are smaller than a voxel."""

MERGED = 0.5
"""Clusters are taken if they are at most this share of the vertices, since their stencils are dozens of times denser. A
mesh of 50,004 vertices in 43,840 cells took minutes to factor by clusters, 12 s by vertices."""

MAX_FACTORED = 120_000
"""Largest number of unknowns that are solved for: in dense foliage each cluster touches dozens, and the factors of
240,000 do not fit into 16 GB. Beyond, points take the mean of the voxels around them."""

MAX_PAIRS = 10_000_000
"""Largest number of pairs of unknowns in one voxel, which all touch each other in the system: 0.4 GB with its factor.
Six sample meshes have up to 110,000 at 32 voxels a side; a mesh in one voxel has the square of its vertices, and is
solved on clusters, or takes the mean of its voxels."""

LINK = 100.0
"""How stiff a part is connected to what it hangs on, over an edge as long as a voxel."""

MINORITY = 0.15
"""A part with less than this share of the surface in a voxel, or somewhat more, takes the voxel's value for its own."""

_SHORTEST_EDGE = 0.01  # in voxels; shorter edges are no stiffer
_CELL = 1 / 3  # in voxels: size of a cluster
_JACOBI = 2 / 3  # damping that smooths best (Trottenberg, Oosterlee and Schüller, Multigrid, section 2.1)
_ANCHOR = 1e-8  # keeps the system definite where a part is in no voxel of its own


@dataclass(frozen=True, kw_only=True)
class SurfaceFit:
    """The factorised system of one mesh and grid, which solves for any values."""

    pull: scipy.sparse.csr_array  # [nodes, V]
    factor: SymmetricFactor
    prolongation: scipy.sparse.csr_array | None  # [N, nodes]; None where nodes are vertices

    def solve(self, values: Float32[np.ndarray, "V D"]) -> Float32[np.ndarray, "N D"]:
        """Values at voxels to values at vertices."""
        nodes = self.factor.solve(np.asarray(self.pull @ values.astype(np.float64)))
        vertices = nodes if self.prolongation is None else self.prolongation @ nodes
        return np.asarray(vertices, np.float32)


def fit_surface(
    mesh: Surface,
    grid: VoxelGrid,
    average: scipy.sparse.csr_array,
    attachments: Attachments,
    *,
    smoothness: float = SMOOTHNESS,
    max_factored: int = MAX_FACTORED,
) -> SurfaceFit | None:
    """Factor the system for one mesh and grid; None if it has too many unknowns, or too many of them in one voxel.

    `average` is `surface_average` of the two, `smoothness` is λ.
    """
    crowded = (_unknowns(average) ** 2).sum() > MAX_PAIRS
    cluster = _clusters(mesh, grid, attachments.part) if mesh.num_vertices > MAX_NODES or crowded else None
    if cluster is not None and cluster.max() >= MERGED * mesh.num_vertices and mesh.num_vertices <= max_factored:
        cluster = None
    if (mesh.num_vertices if cluster is None else cluster.max() + 1) > max_factored:
        return None
    start, end = edges_of(mesh.faces).T
    ties = _edge_ties(mesh, start, end, grid.voxel_size_m)
    links = attachments.differences()
    stiffness = scipy.sparse.diags_array(np.asarray(ties.sum(axis=1)).ravel()) - ties + LINK * (links.T @ links)
    mean, rows = _with_minorities(average.astype(np.float64), attachments.part)
    weight = np.asarray(mean.sum(axis=1)).ravel()  # rows of a share are scaled, and so is what they should be
    values = scipy.sparse.csr_array((weight, rows, np.arange(len(rows) + 1)), shape=(len(rows), len(grid)))
    prolongation = None
    if cluster is not None:
        prolongation = _prolongation(cluster, stiffness.tocsr())
        mean, stiffness = mean @ prolongation, prolongation.T @ stiffness @ prolongation
    if _unknowns(mean).max() ** 2 > MAX_PAIRS:
        return None
    anchor = _ANCHOR * scipy.sparse.eye_array(mean.shape[1])
    system = (mean.T @ mean + smoothness * stiffness + anchor).tocsc()
    return SurfaceFit(pull=(mean.T @ values).tocsr(), factor=factored(system), prolongation=prolongation)


def _unknowns(mean: scipy.sparse.csr_array) -> Int64[np.ndarray, " rows"]:
    """Number of unknowns in each voxel."""
    return np.diff(mean.tocsr().indptr).astype(np.int64)


def _with_minorities(
    average: scipy.sparse.csr_array, part: Int32[np.ndarray, " N"]
) -> tuple[scipy.sparse.csr_array, Int64[np.ndarray, " rows"]]:
    """The mean over each voxel, and the mean of each part over its own share where that is small; each row's voxel.

    Where a part has a small share of a voxel, the mean of all asks next to nothing of it, or everything: to make up
    for a difference d it would move by d over its share.
    """
    entries = average.tocoo()
    keys, group = np.unique(
        entries.row.astype(np.int64) * (int(part.max()) + 1) + part[entries.col], return_inverse=True
    )
    share = np.bincount(group, entries.data)  # rows of `average` sum to 1
    weight = share * np.clip(2 - share / MINORITY, 0, 1)  # of the squared difference
    few = weight > 0
    row = np.cumsum(few) - 1
    chosen = few[group]
    scale = np.sqrt(weight)[group[chosen]] / np.maximum(share[group[chosen]], np.finfo(np.float64).tiny)
    own = scipy.sparse.coo_array(
        (entries.data[chosen] * scale, (row[group[chosen]], entries.col[chosen])),
        shape=(int(few.sum()), average.shape[1]),
    )
    voxels = np.concatenate([np.arange(average.shape[0]), keys[few] // (int(part.max()) + 1)])
    return scipy.sparse.vstack([average, own.tocsr()]).tocsr(), voxels


def _edge_ties(
    mesh: Surface, start: Int32[np.ndarray, " E"], end: Int32[np.ndarray, " E"], size_m: float
) -> scipy.sparse.csr_array:
    """(h / l)² of every edge, both ways [N, N]."""
    length = np.linalg.norm(mesh.vertices[start].astype(np.float64) - mesh.vertices[end], axis=1)
    ties = (size_m / np.maximum(length, _SHORTEST_EDGE * size_m)) ** 2
    places = np.concatenate([start, end]), np.concatenate([end, start])
    return scipy.sparse.coo_array((np.tile(ties, 2), places), shape=(mesh.num_vertices,) * 2).tocsr()


def _clusters(mesh: Surface, grid: VoxelGrid, part: Int32[np.ndarray, " N"]) -> Int64[np.ndarray, " N"]:
    """Each vertex's cluster: the vertices of one part in one cell."""
    cells = np.floor((mesh.vertices - np.asarray(grid.origin_m)) / (_CELL * grid.voxel_size_m)).astype(np.int64)
    return np.unique(np.column_stack([cells, part]), axis=0, return_inverse=True)[1].ravel()


def _prolongation(cluster: Int64[np.ndarray, " N"], stiffness: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Weights of each vertex in the clusters [N, nodes]: smoothed aggregation (Vaněk 1996)."""
    count = len(cluster)
    member = scipy.sparse.csr_array(
        (np.ones(count), cluster, np.arange(count + 1)), shape=(count, int(cluster.max()) + 1)
    )
    damping = _JACOBI / np.maximum(stiffness.diagonal(), _ANCHOR)
    relax = scipy.sparse.eye_array(count) - scipy.sparse.diags_array(damping) @ stiffness
    shares: scipy.sparse.csr_array = (relax @ (relax @ member)).tocsr()
    return shares
