"""A mesh's vertices, one frame at a time: what a viewer that runs in this process calls sixty times a second."""

from typing import no_type_check

import numpy as np
from jaxtyping import Complex128, Float32, Int32

from dynamictree.modal.system import ModalSystem
from dynamictree.parallel import compiled, compiled_reordered, in_bands


class VertexFrames:
    """Plain superposition, prepared once: voxels by real products, vertices by their voxels' weights.

    `displacement` is the mean of each vertex' voxels: what `VoxelInterpolation.apply` gives where there is no `fit`, a
    few times faster. With a fit it is an approximation. Benchmarks use it; `/v1/interact` applies the fit.
    """

    def __init__(
        self, system: ModalSystem, rows: Int32[np.ndarray, "N W"], weights: Float32[np.ndarray, "N W"]
    ) -> None:
        num_voxels, num_modes, _ = system.shapes.shape
        stacked = np.concatenate([system.shapes.real, -system.shapes.imag], axis=1)  # Re φq = Re φ Re q - Im φ Im q
        self._shapes = np.ascontiguousarray(stacked.transpose(0, 2, 1)).reshape(3 * num_voxels, 2 * num_modes)
        self._rows = np.ascontiguousarray(rows)
        self._weights = np.ascontiguousarray(weights)

    def displacement(
        self, q: Complex128[np.ndarray, "G M"], reach: Float32[np.ndarray, "G V"] | None = None
    ) -> Float32[np.ndarray, "N 3"]:
        """Displacement of every vertex at one moment [m].

        Args:
            q: modal coordinates, a row a group of forces.
            reach: w_g of each voxel; by default every group moves the whole tree.
        """
        coordinates = np.concatenate([q.real, q.imag], axis=1).astype(np.float32)  # [G, 2M]
        if reach is None:
            coordinates = coordinates.sum(axis=0, keepdims=True)
            reach = np.ones((1, len(self._shapes) // 3), np.float32)
        voxels = np.zeros((len(self._shapes) // 3, 3), np.float32)
        in_bands(_superpose, len(voxels), self._shapes, coordinates, reach, voxels)
        moved = np.empty((len(self._rows), 3), np.float32)
        in_bands(_gather, len(moved), voxels, self._rows, self._weights, moved)
        return moved


@compiled_reordered
@no_type_check
def _superpose(first, end, shapes, coordinates, reach, voxels):
    for v in range(first, end):
        for group in range(len(coordinates)):
            row = coordinates[group]
            for c in range(3):
                shape = shapes[3 * v + c]
                total = np.float32(0)
                for k in range(len(row)):  # a sum in any order, so in vector registers
                    total += shape[k] * row[k]
                voxels[v, c] += reach[group, v] * total


@compiled
@no_type_check
def _gather(first, end, voxels, rows, weights, moved):
    for n in range(first, end):
        x = y = z = np.float32(0)
        for j in range(rows.shape[1]):
            w = weights[n, j]
            if w > 0:
                v = rows[n, j]
                x += w * voxels[v, 0]
                y += w * voxels[v, 1]
                z += w * voxels[v, 2]
        moved[n, 0], moved[n, 1], moved[n, 2] = x, y, z
