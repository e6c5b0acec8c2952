"""Displacement of a mesh's vertices from modal coordinates, frame by frame, for responses in vertices or Gaussians."""

from typing import no_type_check

import numpy as np
from jaxtyping import Complex128, Float32, Float64

from dynamictree.parallel import compiled_reordered, in_bands
from dynamictree.rig.rig import Rig
from dynamictree.spectrum import bin_weights

_STEPS = np.iinfo(np.int16).max
_BLOCK = 1024
"""Values per block; they and their rows of the basis fit into the L1 cache."""
_AT_ONCE = 6
"""Rows of the basis that are added in one pass over a block, which saves loads and stores of the sum."""


class VertexFrames:
    """Superposition u(p) = Σ_g w_g(p) Re Σ_k φ_k(p) q_{g,k}, with φ_k of the vertices' loop in the rig.

    φ is stored in 16 bits, in steps of max |φ_k| / 32767.
    """

    def __init__(self, rig: Rig, vertices: Float32[np.ndarray, "N 3"]) -> None:
        often = bin_weights(rig.turns.shape[1], rig.num_frames)[1:, None]
        at_vertices = rig.loop(vertices, rig.vertices)[:, 1:] * often  # [N, M, 3]
        parts = np.concatenate([at_vertices.real, -at_vertices.imag], axis=1)  # Re φq = Re φ Re q - Im φ Im q
        flat = parts.transpose(1, 0, 2).reshape(2 * len(often), -1)  # [2M, 3N]
        self._scale = np.maximum(np.abs(flat).max(axis=1, initial=0), np.finfo(np.float32).tiny) / _STEPS
        missing = -len(flat) % _AT_ONCE  # padding rows of zeros, without coordinates in `displacement`
        self._basis = np.pad(np.round(flat / self._scale[:, None]).astype(np.int16), ((0, missing), (0, 0)))
        self._bones = rig.vertices

    @property
    def num_bytes(self) -> int:
        """Size of the basis [bytes]."""
        return int(self._basis.nbytes)

    def weights(self, of_bones: Float64[np.ndarray, "G B"]) -> Float32[np.ndarray, "G N"]:
        """Return w_g of each vertex: the mean over the bones that carry it."""
        return np.asarray((of_bones[:, self._bones.rows] * self._bones.shares).sum(axis=2), np.float32)

    def displacement(
        self, q: Complex128[np.ndarray, "G M"], weights: Float32[np.ndarray, "G N"] | None = None
    ) -> Float32[np.ndarray, "N 3"]:
        """Compute the displacement of every vertex at one moment [m]; `weights` are w_g, by default 1."""
        coordinates = np.zeros((len(q), len(self._basis)), np.float32)
        coordinates[:, : len(self._scale)] = np.concatenate([q.real, q.imag], axis=1) * self._scale  # [G, 2M]
        moved = np.zeros(self._basis.shape[1], np.float32)
        if weights is None:
            in_bands(_superpose, -(-len(moved) // _BLOCK), self._basis, coordinates.sum(axis=0), moved)
        else:
            for row, weight in zip(coordinates, weights, strict=True):
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
        for k in range(0, len(coordinates), _AT_ONCE):
            high = low + _BLOCK
            q0, s0 = coordinates[k], basis[k, low:high]
            q1, s1 = coordinates[k + 1], basis[k + 1, low:high]
            q2, s2 = coordinates[k + 2], basis[k + 2, low:high]
            q3, s3 = coordinates[k + 3], basis[k + 3, low:high]
            q4, s4 = coordinates[k + 4], basis[k + 4, low:high]
            q5, s5 = coordinates[k + 5], basis[k + 5, low:high]
            for i in range(len(values)):
                values[i] += (
                    q0 * np.float32(s0[i])
                    + q1 * np.float32(s1[i])
                    + q2 * np.float32(s2[i])
                    + q3 * np.float32(s3[i])
                    + q4 * np.float32(s4[i])
                    + q5 * np.float32(s5[i])
                )
