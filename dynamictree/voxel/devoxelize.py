"""From voxels back to points: the voxels that each takes its spectrum from. Dev(.) in paper eq. 1."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from jaxtyping import Float32, Int32, Shaped
from scipy.spatial import cKDTree

from dynamictree.mesh import TriangleMesh, edges_of, weld
from dynamictree.voxel.fit import SMOOTHNESS, SurfaceFit, fit_surface
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import surface_average

MAX_VOXELS_PER_POINT = 8


@dataclass(frozen=True, kw_only=True)
class VoxelInterpolation:
    """Prepared once a mesh, applied to any values.

    `rows` and `weights` tell which voxels each point hangs on; the weights are not negative and sum to 1. With a `fit`,
    values are not their plain mean, but the smoothest that the voxels allow.
    """

    rows: Int32[np.ndarray, "N M"]  # into the grid's coords
    weights: Float32[np.ndarray, "N M"]
    num_voxels: int
    fit: SurfaceFit | None = None
    fitted: Int32[np.ndarray, " N"] | None = None  # of the fit's vertices the one that each point is

    def apply(self, values: Shaped[np.ndarray, "V ..."]) -> Shaped[np.ndarray, "N ..."]:
        """Values at voxels to values at points, single precision, real or complex."""
        flat = np.ascontiguousarray(values).reshape(self.num_voxels, -1)
        parts = flat.view(np.float32) if flat.dtype == np.complex64 else flat.astype(np.float32, copy=False)
        result = self._mean(parts) if self.fit is None else self.fit.solve(parts)[self.fitted]  # [N, D]
        whole = np.ascontiguousarray(result).view(np.complex64 if flat.dtype == np.complex64 else np.float32)
        return whole.reshape(len(self.rows), *values.shape[1:])

    def _mean(self, values: Float32[np.ndarray, "V D"]) -> Float32[np.ndarray, "N D"]:
        num_points, width = self.rows.shape
        ends = np.arange(0, num_points * width + 1, width)
        matrix = scipy.sparse.csr_array(
            (self.weights.ravel(), self.rows.ravel(), ends), shape=(num_points, self.num_voxels)
        )
        return np.asarray(matrix @ values)


def nearest(grid: VoxelGrid, points: Float32[np.ndarray, "N 3"]) -> VoxelInterpolation:
    """The voxel that each point lies in, or that has the nearest centre. Paper section 3.5.

    Neighbouring vertices in different voxels move apart: this tears faces, and `smooth` does not.
    """
    in_voxels = (points.astype(np.float64) - grid.origin_m) / grid.voxel_size_m
    rows = np.asarray(cKDTree(grid.coords + 0.5).query(in_voxels)[1])
    return VoxelInterpolation(
        rows=rows[:, None].astype(np.int32), weights=np.ones((len(points), 1), np.float32), num_voxels=len(grid)
    )


def smooth(grid: VoxelGrid, mesh: TriangleMesh, *, smoothness: float = SMOOTHNESS) -> VoxelInterpolation:
    """The smoothest motion of the mesh whose mean over the surface in each voxel is the voxel's, see `fit.py`.

    Only surface that hangs together is asked: a twig that passes close by has no part in it. `rows` and `weights` are
    the voxels that a vertex's faces and its neighbours' faces pass through, by area. Vertices at one place move as one.

    Args:
        grid: of this mesh, from `voxelize`.
        mesh: at rest.
        smoothness: how much an uneven motion costs against a mean that is not the voxel's; more evens out noise.

    Raises:
        InputError: a voxel of the grid holds none of the mesh's surface.
    """
    mesh, vertex = weld(mesh)
    average = surface_average(mesh, grid)
    shares = _rows_to_one(average.T.tocsr())  # [N, V]
    start, end = edges_of(mesh.faces).T
    pairs = np.concatenate([start, end]), np.concatenate([end, start])
    neighbours = scipy.sparse.coo_array((np.ones(len(pairs[0]), np.float32), pairs), shape=(mesh.num_vertices,) * 2)
    shares = _rows_to_one(shares + _rows_to_one(neighbours.tocsr()) @ shares)
    interpolation = _strongest(shares, MAX_VOXELS_PER_POINT)
    loose = np.flatnonzero(interpolation.weights.sum(axis=1) == 0)
    if len(loose):
        interpolation.rows[loose, 0] = nearest(grid, mesh.vertices[loose]).rows[:, 0]
        interpolation.weights[loose, 0] = 1
    return replace(
        interpolation,
        rows=interpolation.rows[vertex],
        weights=interpolation.weights[vertex],
        fit=fit_surface(mesh, grid, average, smoothness=smoothness),
        fitted=vertex,
    )


def _rows_to_one(matrix: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Scale every row that is not empty to sum to 1."""
    total = np.asarray(matrix.sum(axis=1)).ravel()
    scaled: scipy.sparse.csr_array = matrix.multiply(1 / np.where(total > 0, total, 1)[:, None]).tocsr()
    return scaled


def _strongest(shares: scipy.sparse.csr_array, width: int) -> VoxelInterpolation:
    """Keep the largest weights of each row, scaled to sum to 1; rows that have fewer are filled with weight 0."""
    num_points, num_voxels = shares.shape
    point = np.repeat(np.arange(num_points), np.diff(shares.indptr))
    order = np.lexsort((shares.indices, -shares.data, point))
    rank = np.arange(len(point)) - shares.indptr[point]  # in sorted order
    kept = rank < width
    rows, weights = np.zeros((num_points, width), np.int32), np.zeros((num_points, width), np.float32)
    rows[point[kept], rank[kept]] = shares.indices[order][kept]
    weights[point[kept], rank[kept]] = shares.data[order][kept]
    total = weights.sum(axis=1, keepdims=True)
    weights /= np.where(total > 0, total, 1)
    return VoxelInterpolation(rows=rows, weights=weights, num_voxels=num_voxels)
