"""Least-squares fit of a smooth motion of the surface to values at voxels.

The fit minimises, over the values x at the vertices,

    Σ_v |mean of x over the surface in v - c_v|²  +  λ Σ_ij (h / l_ij)² |x_i - x_j|²

with v the voxels, of edge h, and ij the edges of the mesh, of length l_ij. A part of the mesh that is not larger than a
few voxels, such as a leaf card, is connected to the nearest point of a larger part, as if by an edge. So a thin ring of
vertices moves as one, values along a twig are interpolated, and surface that only passes close by has no influence,
even where it lies in the same voxel.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Bool, Float32, Int32
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import surface_pieces

SMOOTHNESS = 0.03
"""λ, chosen on Sapling's and our own trees at 128³ (docs/decisions/core.md): less follows noise, more drags."""

MAX_NODES = 40_000
"""Largest number of unknowns. Larger meshes are solved on clusters of vertices, which are smaller than a voxel."""

SMALL_PART_VOXELS = 3.0
"""Largest extent of a part that is connected to another part instead of moving by itself, in voxels."""

_SHORTEST_EDGE = 0.01  # in voxels; shorter edges are no stiffer
_SHORTEST_BRIDGE = 0.1  # in voxels: parts that only touch are connected less stiffly than one piece
_CELL = 1 / 3  # in voxels: size of a cluster
_JACOBI = 2 / 3  # damping that smooths best (Trottenberg, Oosterlee and Schüller, Multigrid, section 2.1)
_ANCHOR = 1e-8  # keeps the system definite where a part is in no voxel of its own


@dataclass(frozen=True, kw_only=True)
class SurfaceFit:
    """The factorised system of one mesh and grid, which solves for any values."""

    average: scipy.sparse.csr_array  # [V, nodes]
    factor: scipy.sparse.linalg.SuperLU
    prolongation: scipy.sparse.csr_array | None  # [N, nodes]; None where nodes are vertices

    def solve(self, values: Float32[np.ndarray, "V D"]) -> Float32[np.ndarray, "N D"]:
        """Values at voxels to values at vertices."""
        nodes = self.factor.solve(np.asarray(self.average.T @ values.astype(np.float64)))
        vertices = nodes if self.prolongation is None else self.prolongation @ nodes
        return np.asarray(vertices, np.float32)


def fit_surface(
    mesh: TriangleMesh, grid: VoxelGrid, average: scipy.sparse.csr_array, *, smoothness: float = SMOOTHNESS
) -> SurfaceFit:
    """Factor the system for one mesh and grid; `average` is `surface_average` of the two, `smoothness` is λ."""
    start, end = edges_of(mesh.faces).T
    ties = _edge_ties(mesh, start, end, grid.voxel_size_m)
    part = connected_components(ties, directed=False)[1].astype(np.int32)
    bridges = _bridges(mesh, grid, part)
    stiffness = scipy.sparse.diags_array(np.asarray(ties.sum(axis=1)).ravel()) - ties + bridges.T @ bridges
    mean, prolongation = average.astype(np.float64), None
    if mesh.num_vertices > MAX_NODES:
        prolongation = _clusters(mesh, grid, stiffness.tocsr(), part)
        mean, stiffness = mean @ prolongation, prolongation.T @ stiffness @ prolongation
    anchor = _ANCHOR * scipy.sparse.eye_array(mean.shape[1])
    system = (mean.T @ mean + smoothness * stiffness + anchor).tocsc()
    # symmetric and positive definite: no pivoting, and an ordering for Cholesky's pattern
    factor = scipy.sparse.linalg.splu(
        system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return SurfaceFit(average=mean.tocsr(), factor=factor, prolongation=prolongation)


def _edge_ties(
    mesh: TriangleMesh, start: Int32[np.ndarray, " E"], end: Int32[np.ndarray, " E"], size_m: float
) -> scipy.sparse.csr_array:
    """(h / l)² of every edge, both ways [N, N]."""
    length = np.linalg.norm(mesh.vertices[start].astype(np.float64) - mesh.vertices[end], axis=1)
    ties = (size_m / np.maximum(length, _SHORTEST_EDGE * size_m)) ** 2
    places = np.concatenate([start, end]), np.concatenate([end, start])
    return scipy.sparse.coo_array((np.tile(ties, 2), places), shape=(mesh.num_vertices,) * 2).tocsr()


def _bridges(mesh: TriangleMesh, grid: VoxelGrid, part: Int32[np.ndarray, " N"]) -> scipy.sparse.csr_array:
    """Rows that connect each small part to the nearest surface of a larger part, with weight h over the gap [B, N]."""
    small = _small_parts(mesh, part, SMALL_PART_VOXELS * grid.voxel_size_m)
    seeking = np.flatnonzero(small[part])
    if small.all() or len(seeking) == 0:
        return scipy.sparse.csr_array((0, mesh.num_vertices))
    pieces = surface_pieces(mesh, grid.origin_m, grid.voxel_size_m, grid.resolution)
    large = np.flatnonzero(~small[part[mesh.faces[pieces.faces, 0]]])
    corners = mesh.faces[pieces.faces[large]]  # [P, 3]
    places = np.einsum("pi,pic->pc", pieces.centroids[large], mesh.vertices[corners])
    gap, nearest = (np.asarray(column) for column in cKDTree(places).query(mesh.vertices[seeking]))
    order = np.lexsort((gap, part[seeking]))
    first = order[np.unique(part[seeking][order], return_index=True)[1]]  # each part's shortest gap
    piece = nearest[first]
    strength = grid.voxel_size_m / np.maximum(gap[first], _SHORTEST_BRIDGE * grid.voxel_size_m)
    weights = np.concatenate([strength[:, None], -strength[:, None] * pieces.centroids[large][piece]], axis=1)
    columns = np.concatenate([seeking[first][:, None], corners[piece]], axis=1)  # [B, 4]
    ends = np.arange(0, columns.size + 1, 4)
    return scipy.sparse.csr_array((weights.ravel(), columns.ravel(), ends), shape=(len(first), mesh.num_vertices))


def _small_parts(mesh: TriangleMesh, part: Int32[np.ndarray, " N"], size_m: float) -> Bool[np.ndarray, " parts"]:
    num_parts = int(part.max()) + 1
    low, high = np.full((num_parts, 3), np.inf), np.full((num_parts, 3), -np.inf)
    np.minimum.at(low, part, mesh.vertices)
    np.maximum.at(high, part, mesh.vertices)
    small: Bool[np.ndarray, " parts"] = (high - low).max(axis=1) < size_m
    return small


def _clusters(
    mesh: TriangleMesh, grid: VoxelGrid, stiffness: scipy.sparse.csr_array, part: Int32[np.ndarray, " N"]
) -> scipy.sparse.csr_array:
    """Weights of each vertex in clusters of near vertices of one part [N, nodes]: smoothed aggregation (Vaněk 1996)."""
    cells = np.floor((mesh.vertices - np.asarray(grid.origin_m)) / (_CELL * grid.voxel_size_m)).astype(np.int64)
    cluster = np.unique(np.column_stack([cells, part]), axis=0, return_inverse=True)[1].ravel()
    member = scipy.sparse.csr_array(
        (np.ones(mesh.num_vertices), cluster, np.arange(mesh.num_vertices + 1)),
        shape=(mesh.num_vertices, int(cluster.max()) + 1),
    )
    damping = _JACOBI / np.maximum(stiffness.diagonal(), _ANCHOR)
    relax = scipy.sparse.eye_array(mesh.num_vertices) - scipy.sparse.diags_array(damping) @ stiffness
    shares: scipy.sparse.csr_array = (relax @ (relax @ member)).tocsr()
    return shares
