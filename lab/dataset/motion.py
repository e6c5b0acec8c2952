"""Rigid motion of each node, and the resulting displacement and spectrum of vertices."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Int, Int32

from dynamictree.parallel import single_thread
from dynamictree.spectrum import NUM_FREQUENCIES


@dataclass(frozen=True, kw_only=True)
class Sway:
    """Rigid motion of every node at every frame; a vertex at offset o from its node moves by shift + (turn) o."""

    shift: Float32[np.ndarray, "T B 3"]  # [m]
    turn: Float32[np.ndarray, "T B 3 3"]  # rotation matrix minus the identity
    position: Float32[np.ndarray, "B 3"]  # node positions at rest [m]

    def frames(self, chosen: Int[np.ndarray, " S"]) -> "Sway":
        """Select some of the frames."""
        return Sway(shift=self.shift[chosen], turn=self.turn[chosen], position=self.position)

    def displacement(
        self, vertices: Float32[np.ndarray, "N 3"], node: Int32[np.ndarray, " N"]
    ) -> Float32[np.ndarray, "T N 3"]:
        """Return the displacement of vertices, given each vertex's node, at every frame [m]."""
        offset = vertices - self.position[node]
        frames = zip(self.shift, self.turn, strict=True)
        return np.stack([shift[node] + np.einsum("nxy,ny->nx", turn[node], offset) for shift, turn in frames])


def node_spectrum(
    motion: Sway, num_frequencies: int = NUM_FREQUENCIES
) -> tuple[Complex64[np.ndarray, "K B 3"], Complex64[np.ndarray, "K B 3 3"]]:
    """Transform the nodes' motions: return the first bins of shift and turn. A vertex's spectrum is linear in them."""
    frames, nodes = motion.shift.shape[:2]
    turning = -2j * np.pi * np.arange(num_frequencies)[:, None] * np.arange(frames) / frames
    transform = (np.exp(turning) / frames).astype(np.complex64)
    series = np.concatenate([motion.shift.reshape(frames, -1), motion.turn.reshape(frames, -1)], axis=1)
    with single_thread():
        both = np.concatenate([transform.real, transform.imag]) @ series  # [2K, 12 B]: real, no complex copy
    hat = both[:num_frequencies] + 1j * both[num_frequencies:]
    split = 3 * nodes
    return hat[:, :split].reshape(-1, nodes, 3), hat[:, split:].reshape(-1, nodes, 3, 3)


def vertex_spectrum(
    motion: Sway,
    vertices: Float32[np.ndarray, "N 3"],
    node: Int32[np.ndarray, " N"],
    num_frequencies: int = NUM_FREQUENCIES,
) -> Complex64[np.ndarray, "N K 3"]:
    """Return the spectrum of every vertex's motion [m], without computing the motion."""
    shift, turn = node_spectrum(motion, num_frequencies)
    offset = vertices - motion.position[node]
    spectrum = np.empty((len(vertices), num_frequencies, 3), np.complex64)
    for k in range(num_frequencies):
        spectrum[:, k] = shift[k, node] + np.einsum("nxy,ny->nx", turn[k, node], offset)
    return spectrum
