"""Forward kinematics of the bones between the root and one point, with derivatives.

Bone b of the chain turns by R_b = A_b exp[θ_b]×, A_b = A_{b-1} exp[κ_b]×: θ_b comes from the modes and turns this bone
only, κ_b is the local bend of its joint and also turns everything beyond it. The point goes to

    x = x_0 + Σ_b R_b s_b,        s_b from the joint of b to the next joint, or to the point.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int64

from dynamictree.modal.bones import Bones
from dynamictree.parallel import compiled


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Bones from the grip's own towards the root, which cannot turn and is left out."""

    bones: Int64[np.ndarray, " n"]
    segments_m: Float64[np.ndarray, "n 3"]  # s

    def __len__(self) -> int:
        return len(self.bones)


def rows_to_root(bones: Bones, bone: int) -> Int64[np.ndarray, " n"]:
    """A bone and its ancestors without the root."""
    rows = []
    while bones.parent[bone] >= 0:
        rows.append(bone)
        bone = int(bones.parent[bone])
    return np.array(rows, np.int64)


def chain_to(bones: Bones, bone: int, point_m: Float32[np.ndarray, " 3"]) -> Chain:
    """The chain under a point that a bone carries."""
    rows = rows_to_root(bones, bone)
    ends = np.concatenate([point_m[None], bones.joint_m[rows[:-1]]])[: len(rows)].astype(np.float64)
    return Chain(bones=rows, segments_m=ends - bones.joint_m[rows])


def reach(
    chain: Chain, turns: Float64[np.ndarray, "n 3"], bends: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, "3 n3"], Float64[np.ndarray, "3 n3"]]:
    """Displacement of the point [m], and its derivatives by the turns θ and by the bends κ [m/rad]."""
    moved, by_turns, by_bends = _reach(chain.segments_m[::-1].copy(), turns[::-1].copy(), bends[::-1].copy())
    n = len(chain)
    return moved, by_turns[:, ::-1].reshape(3, 3 * n), by_bends[:, ::-1].reshape(3, 3 * n)


@compiled
@no_type_check
def _reach(segments, turns, bends):
    n = len(segments)
    before = np.empty((n, 3, 3))  # A_{b-1}
    arms = np.empty((n, 3))  # R_b s_b
    by_turns, by_bends = np.empty((3, n, 3)), np.empty((3, n, 3))
    frame = np.eye(3)
    moved, arm = np.zeros(3), np.zeros(3)
    for b in range(n):
        before[b] = frame
        bend, _ = _rotation(bends[b])
        turn, by_turn = _rotation(turns[b])
        frame = _product(frame, bend)
        arms[b] = _carried(frame, _carried(turn, segments[b]))
        moved += arms[b] - segments[b]
        by_turns[:, b] = -_product(_cross(arms[b]), _product(frame, by_turn))  # [R v]× R = R [v]×
    for b in range(n - 1, -1, -1):
        arm += arms[b]  # from the joint of b to the point, as they stand
        _, by_bend = _rotation(bends[b])
        by_bends[:, b] = -_product(_cross(arm), _product(before[b], by_bend))
    return moved, by_turns, by_bends


@compiled
@no_type_check
def _rotation(v):
    """exp[v]× by Rodrigues' formula, and its left Jacobian."""
    angle = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    if angle > 1e-3:
        s, d, e = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    else:
        s, d, e = 1 - angle**2 / 6, 0.5 - angle**2 / 24, 1 / 6 - angle**2 / 120
    cross = _cross(v)
    square = _product(cross, cross)
    return np.eye(3) + s * cross + d * square, np.eye(3) + d * cross + e * square


@compiled
@no_type_check
def _cross(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@compiled
@no_type_check
def _product(a, b):
    c = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            c[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return c


@compiled
@no_type_check
def _carried(a, v):
    return np.array([a[i, 0] * v[0] + a[i, 1] * v[1] + a[i, 2] * v[2] for i in range(3)])
