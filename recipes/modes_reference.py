"""Reference in Python for clients that evaluate a tree's modes themselves. Needs only numpy and safetensors."""

from typing import NamedTuple

import numpy as np
from safetensors.numpy import load

OUTWARD = 32.0


class Reach(NamedTuple):
    """Participation of the bones in a group."""

    weights: np.ndarray  # [B]
    ends: dict[int, np.ndarray]  # end points of the place's own bone and of the bones that carry it
    hangs: np.ndarray  # [B], true if a bone hangs on the place


class Modes:
    """`content` is the body of GET /v1/spectra/{id}/modes."""

    def __init__(self, content: bytes) -> None:
        self.file = load(content)
        self.shapes = self.file["shapes"].astype(np.float32) * self.file["scale_m"][:, None, None]  # [V, K, 3, 2]
        self.turns = self.file["bone_turns"].astype(np.float32) * self.file["bone_scale_rad"][:, None, None]
        self.parent, self.foot = self.file["bone_parent"], self.file["bone_foot_m"].astype(float)
        self.reach_m = self.file["bone_reach_m"].astype(float)

    def voxels(self, q: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Compute the plain superposition u [V, 3] of one frame, from q [G, K, 2] and weights [G, V] in [0, 1]."""
        return _superposed(self.shapes, q, weights)

    def reach(self, seed_voxel: int, falloff_m: float) -> Reach:
        """Compute the participation of the bones in a group of this locality."""
        length, bone, way = np.linalg.norm(self.reach_m, axis=1), int(self.file["bone_of_voxel"][seed_voxel]), 0.0
        cost, ends = np.full(len(length), np.inf), {bone: self.foot[bone] + self.reach_m[bone]}
        seed, hangs = bone, np.zeros(len(length), bool)
        while bone >= 0:
            cost[bone] = way
            way += (0.5 if bone == seed else 1.0) * np.linalg.norm(ends[bone] - self.foot[bone])
            if self.parent[bone] >= 0:
                ends[int(self.parent[bone])] = self.foot[bone]
            bone = int(self.parent[bone])
        for b in range(1, len(length)):  # parents come before children
            if b in ends:
                continue
            a = int(self.parent[b])
            hangs[b] = a == seed or hangs[a]
            cost[b] = cost[a] if hangs[b] else cost[a] + OUTWARD * length[b] if a > 0 else np.inf
        return Reach(np.exp(-((cost / falloff_m) ** 2)), ends, hangs)

    def theta(self, q: np.ndarray, reaches: list[Reach | None]) -> np.ndarray:
        """Compute the turn of each bone [B, 3] from q [G, K, 2]; a group without a reach moves the whole tree."""
        total = np.zeros_like(self.foot)
        for coordinates, reach in zip(q, reaches, strict=True):
            own = _superposed(self.turns, coordinates[None], np.ones((1, len(total)))).astype(float)
            total += own if reach is None else self._local(own, reach)
        return total

    def _local(self, own: np.ndarray, reach: Reach) -> np.ndarray:
        turn, shift, w = own.copy(), np.zeros_like(own), reach.weights
        for b in range(1, len(own)):
            a = int(self.parent[b])
            shift[b] = shift[a] + np.cross(own[a], self.foot[b] - self.foot[a])
            if b in reach.ends:
                arm = reach.ends[b] - self.foot[b]
                turn[b] = w[b] * own[b] + (w[b] - w[a]) / max(arm @ arm, 1e-12) * np.cross(arm, shift[b])
            elif not reach.hangs[b]:
                turn[b] = turn[a] + w[b] * (own[b] - own[a])
        turn[0] = 0
        return turn

    def bends(self, seed_voxel: int, bend: np.ndarray) -> np.ndarray:
        """Expand a group's `bend` [n, 3], ordered from its place's joint towards the root, to all joints [J, 3]."""
        every = np.zeros_like(self.file["joint_place_m"])
        joint = self.file["joint_of_bone"][self.file["bone_of_voxel"][seed_voxel]]
        for turn in bend:
            every[joint], joint = turn, self.file["joint_parent"][joint]
        return every

    def poses(self, theta: np.ndarray, bends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute rotation [B, 3, 3] and place [B, 3] of each bone; its point x moves to R (x - foot) + place.

        `bends` [J, 3] is the sum of the groups' bends: each turns its joint and everything beyond it.
        """
        rotation, place = np.stack([_turn_matrix(t) for t in theta]), self.foot.copy()
        for b in range(1, len(place)):  # parents come before children
            a = self.parent[b]
            place[b] = place[a] + rotation[a] @ (self.foot[b] - self.foot[a])
        at, above = self.file["joint_place_m"].astype(float), self.file["joint_parent"]
        frame, there = np.tile(np.eye(3), (len(at), 1, 1)), at.copy()
        for j in range(1, len(at)):
            there[j] = there[above[j]] + frame[above[j]] @ (at[j] - at[above[j]])
            frame[j] = frame[above[j]] @ _rotation(bends[j])
        of = self.file["joint_of_bone"]
        return frame[of] @ rotation, there[of] + np.einsum("bij,bj->bi", frame[of], place - at[of])


def _superposed(shapes: np.ndarray, q: np.ndarray, weights: np.ndarray) -> np.ndarray:
    mixed = np.einsum("gn,gkc->nkc", weights, q)  # Σ_g w_g q_g; Re φq = Re φ Re q - Im φ Im q
    return np.einsum("nkx,nk->nx", shapes[..., 0], mixed[..., 0]) - np.einsum(
        "nkx,nk->nx", shapes[..., 1], mixed[..., 1]
    )


def _turn_matrix(theta: np.ndarray) -> np.ndarray:
    """Return the rotation by atan |θ| about θ."""
    size = max(float(np.linalg.norm(theta)), 1e-12)
    return _rotation(theta * np.arctan(size) / size)


def _rotation(turn: np.ndarray) -> np.ndarray:
    angle = max(float(np.linalg.norm(turn)), 1e-12)
    x, y, z = turn / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
