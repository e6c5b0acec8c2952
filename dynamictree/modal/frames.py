"""A mesh's vertices at any modal coordinates, one frame at a time: what every answer in vertices or Gaussians calls."""

from typing import no_type_check

import numpy as np
from jaxtyping import Complex128, Float32

from dynamictree.devoxelize.interpolation import VoxelInterpolation
from dynamictree.modal.system import ModalSystem
from dynamictree.parallel import compiled_reordered, in_bands

_STEPS = np.iinfo(np.int16).max
_BLOCK = 1024
"""Values that are summed together: they and their rows of the basis stay in a core's first cache."""


class VertexFrames:
    """u(p) = Σ_g w_g(p) Re Σ_k φ_k(p) q_{g,k} with each φ_k interpolated to the vertices once.

    The interpolation is linear, so for forces that move the whole tree this is the interpolation of the voxels' motion,
    without its solve in every frame. φ is stored in 16 bits: steps of max |φ_k| / 32767.
    """

    def __init__(self, system: ModalSystem, interpolation: VoxelInterpolation) -> None:
        at_vertices = interpolation.apply(system.shapes)  # [N, M, 3]
        parts = np.concatenate([at_vertices.real, -at_vertices.imag], axis=1)  # Re φq = Re φ Re q - Im φ Im q
        flat = parts.transpose(1, 0, 2).reshape(2 * system.num_modes, -1)  # [2M, 3N]
        self._scale = np.maximum(np.abs(flat).max(axis=1, initial=0), np.finfo(np.float32).tiny) / _STEPS
        self._basis = np.round(flat / self._scale[:, None]).astype(np.int16)
        self._interpolation = interpolation

    @property
    def num_bytes(self) -> int:
        """Size of the basis [bytes]."""
        return int(self._basis.nbytes)

    def weights(self, of_voxels: Float32[np.ndarray, "G V"]) -> Float32[np.ndarray, "G N"]:
        """w_g of each vertex: the mean over the voxels that it depends on."""
        return np.ascontiguousarray(self._interpolation.mean(np.ascontiguousarray(of_voxels.T)).T)

    def displacement(
        self, q: Complex128[np.ndarray, "G M"], weights: Float32[np.ndarray, "G N"] | None = None
    ) -> Float32[np.ndarray, "N 3"]:
        """Displacement of every vertex at one moment [m].

        Args:
            q: modal coordinates, a row per group of forces.
            weights: w_g of each vertex; by default every group moves the whole tree.
        """
        coordinates = np.concatenate([q.real, q.imag], axis=1) * self._scale  # [G, 2M]
        moved = np.zeros(self._basis.shape[1], np.float32)
        if weights is None:
            whole = np.ascontiguousarray(coordinates.sum(axis=0), np.float32)
            in_bands(_superpose, -(-len(moved) // _BLOCK), self._basis, whole, moved)
        else:
            for row, weight in zip(coordinates.astype(np.float32), weights, strict=True):
                part = np.zeros_like(moved)
                in_bands(_superpose, -(-len(moved) // _BLOCK), self._basis, row, part)
                moved += part * np.repeat(weight, 3)
        return moved.reshape(-1, 3)


@compiled_reordered
@no_type_check
def _superpose(first, end, basis, coordinates, moved):
    for block in range(first, end):
        low = block * _BLOCK
        values = moved[low : low + _BLOCK]
        for k in range(len(coordinates)):
            amount = coordinates[k]
            shape = basis[k, low : low + _BLOCK]
            for i in range(len(values)):
                values[i] += amount * np.float32(shape[i])
