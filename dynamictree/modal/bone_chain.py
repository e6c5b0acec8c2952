"""Forward kinematics of the bones under one point that several of them carry, with derivatives.

Bone b turns by R_b = A_b exp[θ_b]×, A_b = A_a exp[κ_b]×, a its parent: θ_b comes from the modes and turns this bone
only, κ_b is the local bend of its joint and also turns everything beyond it. A point that bones j carry with the
weights w_j goes to

    x = x_0 + Σ_b R_b s_b,        s_b = Σ_j w_j s_bj,

s_bj from the joint of b to the next joint on the way to j, or to the point.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64

from dynamictree.modal.bones import Bones
from dynamictree.parallel import compiled


@dataclass(frozen=True, kw_only=True)
class Place:
    """A point and the n bones under it, parents before children. A root cannot turn and is left out."""

    bones: Int64[np.ndarray, " n"]
    above: Int64[np.ndarray, " n"]  # row of each one's parent here; -1 of a root
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


def place_of(
    bones: Bones, point_m: Float32[np.ndarray, " 3"], rows: Int32[np.ndarray, " W"], weights: Float32[np.ndarray, " W"]
) -> Place:
    """The bones under a point that bones `rows` carry, and its arm about each."""
    joint, arms = bones.joint_m.astype(np.float64), dict[int, Float64[np.ndarray, " 3"]]()
    for first, weight in zip(rows.tolist(), weights.astype(np.float64).tolist(), strict=True):
        end = point_m.astype(np.float64)
        for bone in rows_to_root(bones, first).tolist() if weight > 0 else ():
            arms[bone] = arms.get(bone, np.zeros(3)) + weight * (end - joint[bone])
            end = joint[bone]
    under = np.array(sorted(arms), np.int64)
    parent = bones.parent[under]
    return Place(
        bones=under,
        above=np.where(np.isin(parent, under), under.searchsorted(parent), -1),
        segments_m=np.array([arms[bone] for bone in under.tolist()]).reshape(-1, 3),
    )


def reach(
    place: Place, turns: Float64[np.ndarray, "n 3"], bends: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, "3 n3"], Float64[np.ndarray, "3 n3"]]:
    """Displacement of the point [m], and its derivatives by the turns θ and by the bends κ [m/rad]."""
    moved, by_turns, by_bends = _reach(place.above, place.segments_m, turns, bends)
    return moved, by_turns.reshape(3, -1), by_bends.reshape(3, -1)


@compiled
@no_type_check
def _reach(above, segments, turns, bends):
    n = len(segments)
    frame, before = np.empty((n, 3, 3)), np.empty((n, 3, 3))  # A, and that of the parent
    arms = np.empty((n, 3))  # R_b s_b, and then the sum over all that b carries
    by_turns, by_bends = np.empty((3, n, 3)), np.empty((3, n, 3))
    moved = np.zeros(3)
    for b in range(n):
        before[b] = np.eye(3) if above[b] < 0 else frame[above[b]]
        frame[b] = _product(before[b], _rotation(bends[b])[0])
        turn, by_turn = _rotation(turns[b])
        arms[b] = _carried(frame[b], _carried(turn, segments[b]))
        moved += arms[b] - segments[b]
        by_turns[:, b] = -_product(_cross(arms[b]), _product(frame[b], by_turn))  # [R v]× R = R [v]×
    for b in range(n - 1, -1, -1):  # children come after their parents
        by_bends[:, b] = -_product(_cross(arms[b]), _product(before[b], _rotation(bends[b])[1]))
        if above[b] >= 0:
            arms[above[b]] += arms[b]
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
