"""Moments of the surface in each voxel, which distinguish a card from a thin twig."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64

from dynamictree.mesh import Surface
from dynamictree.voxel.clip_kernel import SurfacePieces
from dynamictree.voxel.grid import VoxelGrid

NUM_MOMENTS = 16
AREA, OFFSET, SPREAD, NORMAL = slice(0, 1), slice(1, 4), slice(4, 10), slice(10, 16)
"""Area; its centroid, relative to the voxel's centre; second moment of the area about its centroid; mean of n nᵀ, which
has rank one for a card, whatever its orientation, and rank two for a tube. In voxels; tensors as SIX."""
SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def moments_of(
    mesh: Surface, grid: VoxelGrid, pieces: SurfacePieces, rows: Int64[np.ndarray, " P"]
) -> Float32[np.ndarray, "V 16"]:
    """Compute NUM_MOMENTS numbers per voxel from its pieces of surface; `rows` are the pieces' voxels."""
    at_once = 1 << 20  # number of pieces whose corners are gathered at once, 72 MB
    vertices = (mesh.vertices.astype(np.float64) - grid.origin_m) / grid.voxel_size_m
    corners = vertices[mesh.faces]  # [F, 3, 3]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    place = np.empty((len(rows), 3))
    for start in range(0, len(rows), at_once):
        some = slice(start, start + at_once)
        at = np.einsum("pc,pcx->px", pieces.centroids[some], corners[pieces.faces[some]])
        place[some] = at - grid.coords[rows[some]] - 0.5
    area = np.bincount(rows, pieces.areas, len(grid))
    columns = _columns(place, pieces, _six(normal))
    total = np.stack([np.bincount(rows, pieces.areas * column, len(grid)) for column in columns], axis=1)
    mean = total / area[:, None]
    mean[:, 3:9] -= _six(mean[:, :3])
    return np.asarray(np.concatenate([area[:, None], mean], axis=1), np.float32)


def _columns(
    place: Float64[np.ndarray, "P 3"], pieces: SurfacePieces, facing: Float64[np.ndarray, "F 6"]
) -> Iterator[Float64[np.ndarray, " P"]]:
    """Yield the columns to average in each voxel, one by one, since all take 120 bytes per piece."""
    yield from place.T
    for number, (i, j) in enumerate(SIX):
        flat = float(i == j) - facing[pieces.faces, number]
        yield place[:, i] * place[:, j] + pieces.areas / 12 * flat  # second moment of a square piece of this area
    for number in range(len(SIX)):
        yield facing[pieces.faces, number]


def moments_of_normals(normals: Float32[np.ndarray, "V 3"]) -> Float32[np.ndarray, "V 16"]:
    """Estimate moments without a mesh, as if one square card lay across each voxel."""
    facing = _six(normals.astype(np.float64))
    flat = (_six(np.eye(3)).sum(axis=0) - facing) / 12
    area, offset = np.ones((len(normals), 1)), np.zeros((len(normals), 3))
    return np.concatenate([area, offset, flat, facing], axis=1).astype(np.float32)


def coarse_moments(
    moments: Float32[np.ndarray, "V 16"], fine: VoxelGrid, coarse: VoxelGrid, owner: Int32[np.ndarray, " V"]
) -> Float32[np.ndarray, "W 16"]:
    """Compute the moments in larger voxels; `owner` is the coarse row of each fine voxel."""
    factor = fine.resolution // coarse.resolution
    area = moments[:, AREA].astype(np.float64)
    place = (fine.coords + 0.5 + moments[:, OFFSET]) / factor - coarse.coords[owner] - 0.5
    columns = np.concatenate([place, moments[:, SPREAD] / factor**2 + _six(place), moments[:, NORMAL]], axis=1) * area
    total = np.bincount(owner, area[:, 0], len(coarse))
    mean = np.stack([np.bincount(owner, column, len(coarse)) for column in columns.T], axis=1) / total[:, None]
    mean[:, 3:9] -= _six(mean[:, :3])
    return np.concatenate([total[:, None] / factor**2, mean], axis=1).astype(np.float32)


def _six(vectors: Float64[np.ndarray, "N 3"]) -> Float64[np.ndarray, "N 6"]:
    """Compute the products of components, in the order of SIX."""
    return np.stack([vectors[:, i] * vectors[:, j] for i, j in SIX], axis=1)
