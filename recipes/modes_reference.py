"""Evaluate a tree's modes yourself: the reference for clients, in Python. Needs numpy and safetensors alone."""

import numpy as np
from safetensors.numpy import load


class Modes:
    """`content` is the body of GET /v1/spectra/{id}/modes."""

    def __init__(self, content: bytes) -> None:
        self.file = load(content)
        scale = self.file["scale_m"][:, None, None]
        self.shapes = self.file["shapes"].astype(np.float32) * scale  # [V, K, 3, 2]
        self.bone_shapes = self.file["bone_shapes"].astype(np.float32) * scale

    def voxels(self, q: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Plain superposition: u [V, 3] of one frame, from q [G, K, 2] and weights [G, V] in [0, 1]."""
        return _superposed(self.shapes, q, weights)

    def bends(self, seed_voxel: int, bend: np.ndarray) -> np.ndarray:
        """A group's `bend` [n, 3], given from its grip's bone towards the root, for all bones [B, 3]."""
        bone, every = self.file["bone_of_voxel"][seed_voxel], np.zeros_like(self.file["bone_joint_m"])
        for turn in bend:
            every[bone], bone = turn, self.file["bone_parent"][bone]
        return every

    def poses(
        self, q: np.ndarray, weights: np.ndarray, bends: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The warp: rotation [B, 3, 3] and place [B, 3] of each bone; its point x goes to R (x - joint) + place.

        `bends` [B, 3] is the sum of the groups' bends: each turns its bone and everything beyond it.
        """
        bone, parent = self.file["bone_of_voxel"], self.file["bone_parent"]
        joint, reach = self.file["bone_joint_m"], self.file["bone_reach_m"]
        count = np.bincount(bone, minlength=len(parent))
        per_bone = np.stack([np.bincount(bone, row, len(parent)) / count for row in weights])
        moved = _superposed(self.bone_shapes, q, per_bone)
        above = np.where(parent < 0, np.arange(len(parent)), parent)
        turn = np.cross(reach, moved - moved[above]) / self.file["bone_lever_m2"][:, None]
        rotation, place = np.stack([_rotation(t) for t in turn]), joint.copy()
        frame = np.stack([_rotation(t) for t in (np.zeros_like(joint) if bends is None else bends)])
        for b in np.flatnonzero(parent >= 0):  # parents come before children
            frame[b] = frame[parent[b]] @ frame[b]
        rotation = frame @ rotation
        for b in np.flatnonzero(parent >= 0):
            place[b] = place[parent[b]] + rotation[parent[b]] @ (joint[b] - joint[parent[b]])
        return rotation, place


def _superposed(shapes: np.ndarray, q: np.ndarray, weights: np.ndarray) -> np.ndarray:
    mixed = np.einsum("gn,gkc->nkc", weights, q)  # Σ_g w_g q_g; Re φq = Re φ Re q - Im φ Im q
    return np.einsum("nkx,nk->nx", shapes[..., 0], mixed[..., 0]) - np.einsum(
        "nkx,nk->nx", shapes[..., 1], mixed[..., 1]
    )


def _rotation(turn: np.ndarray) -> np.ndarray:
    angle = max(float(np.linalg.norm(turn)), 1e-12)
    x, y, z = turn / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
