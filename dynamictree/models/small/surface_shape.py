"""Shape features of the surface in and around a voxel: line, plane or clump, one card or many sides.

Moments of the surface (`voxel.moments`) are averaged along the tree over wider and wider surroundings; eigenvalues do
not change when the tree is turned, and have the same meaning on any species.
"""

import numpy as np
from jaxtyping import Float32, Float64
from scipy.sparse import csr_array

from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.moments import AREA, NORMAL, OFFSET, SIX, SPREAD

STEPS = (0, 1, 3, 8)
"""Numbers of times that the mean over touching voxels is applied."""
DIRECTED = (0, 3)
"""Those of STEPS at which the full tensors are features."""
NUM_SURFACE = 6 * len(STEPS) + 1
NUM_TENSORS = 2 * len(DIRECTED)


def surface_features(
    grid: VoxelGrid, moments: Float32[np.ndarray, "V 16"], touching: csr_array, *, has_moments: bool
) -> tuple[Float32[np.ndarray, "V S"], Float32[np.ndarray, "V R 3 3"]]:
    """Compute invariants, and second moments of place and normal in the grid's frame.

    `touching` is the mean over touching voxels (`neighbour_means`); `has_moments` tells if the moments are of a mesh.
    """
    centre = grid.coords.mean(axis=0)
    area = moments[:, AREA].astype(np.float64)
    place = grid.coords - centre + moments[:, OFFSET]
    weighted = np.concatenate([np.ones_like(area), place, moments[:, SPREAD] + _six(place), moments[:, NORMAL]], axis=1)
    weighted *= area
    columns, tensors = [], []
    for step in range(max(STEPS) + 1):
        if step in STEPS:
            mean = weighted[:, 1:] / weighted[:, :1]
            spread, normal = mean[:, 3:9] - _six(mean[:, :3]), mean[:, 9:]
            columns += [
                np.log(weighted[:, :1]),
                np.sqrt(np.maximum(eigenvalues(spread), 0)),
                eigenvalues(normal)[:, 1:],
            ]
            if step in DIRECTED:
                tensors += [_full(spread), _full(normal)]
        weighted = touching @ weighted
    columns.append(np.full((len(grid), 1), float(has_moments)))
    return np.concatenate(columns, axis=1).astype(np.float32), np.stack(tensors, axis=1).astype(np.float32)


def eigenvalues(six: Float64[np.ndarray, "V 6"]) -> Float64[np.ndarray, "V 3"]:
    """Return ascending eigenvalues of symmetric matrices, in closed form: 30 times as fast as LAPACK (Smith 1961)."""
    xx, yy, zz, xy, xz, yz = six.T
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    size = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6) + 1e-30
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    angle = np.arccos(np.clip(determinant / (2 * size**3), -1, 1)) / 3
    high = mean + 2 * size * np.cos(angle)
    low = mean + 2 * size * np.cos(angle + 2 * np.pi / 3)
    return np.stack([low, 3 * mean - high - low, high], axis=1)


def _six(vectors: Float64[np.ndarray, "V 3"]) -> Float64[np.ndarray, "V 6"]:
    return np.stack([vectors[:, i] * vectors[:, j] for i, j in SIX], axis=1)


def _full(six: Float64[np.ndarray, "V 6"]) -> Float64[np.ndarray, "V 3 3"]:
    matrix = np.empty((len(six), 3, 3))
    for column, (i, j) in zip(six.T, SIX, strict=True):
        matrix[:, i, j] = matrix[:, j, i] = column
    return matrix
