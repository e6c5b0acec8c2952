"""Warp: rotate bones under large pushes, where linear modes would stretch the tree.

A mode moves each point along a straight line, so a branch that is pushed far grows longer. Here the plain answer
turns bones instead. The centre of bone b wants to go by u_b = Σ_g w_g(b) Re Σ_k φ_k(b) q_{g,k}, w the mean over its
voxels; with r its reach from its parent a at rest, it turns by the smallest rotation that carries r along,

    θ_b = r × (u_b − u_a) / (|r|² + h²),        R_b = exp [θ_b]×,        h half a voxel,

about its joint, the parent's centre, which the parent carries:

    joint'_b = joint'_a + R_a (joint_b − joint_a),        x' = joint'_b + R_b (x − joint_b).

To first order that is the plain answer less its stretching along the bones; bones never change their length.

A pull may also bend single joints (`pull.py`). A bend κ_b turns bone b and everything beyond it:

    A_b = A_a exp [κ_b]×,        R_b = A_b exp [θ_b]×.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Complex128, Float32, Int32

from dynamictree.modal.bones import Bones
from dynamictree.parallel import compiled, in_bands


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Pose of every bone: x' = rotation (x - joint) + place."""

    rotation: Float32[np.ndarray, "B 3 3"]
    place_m: Float32[np.ndarray, "B 3"]  # joint'


def bone_weights(bones: Bones, weights: Float32[np.ndarray, "G V"]) -> Float32[np.ndarray, "G B"]:
    """Mean weight of each bone's voxels, a group a row."""
    count = np.bincount(bones.bone_of_voxel, minlength=len(bones.parent))
    total = np.stack([np.bincount(bones.bone_of_voxel, row, minlength=len(bones.parent)) for row in weights])
    return np.asarray((total / count).astype(np.float32))


def bone_turns(
    bones: Bones, weights: Float32[np.ndarray, "G B"], q: Complex128[np.ndarray, "G M"]
) -> Float32[np.ndarray, "B 3"]:
    """θ: how far each bone turns [rad]."""
    coordinates = (weights[:, :, None] * q[:, None, :]).sum(axis=0).astype(np.complex64)  # Σ_g w_g q_g, [B, M]
    moved = (coordinates[:, None, :] @ bones.shapes)[:, 0].real  # u, [B, 3]
    above = np.where(bones.parent < 0, np.arange(len(bones.parent)), bones.parent)
    turns = np.cross(bones.reach_m, moved - moved[above]) / bones.lever_m2[:, None]
    return np.asarray(turns.astype(np.float32))


def pose(bones: Bones, turns: Float32[np.ndarray, "B 3"], bends: Float32[np.ndarray, "B 3"] | None = None) -> Pose:
    """Forward kinematics: rotate every bone together with its children; `bends` are κ of the joints."""
    rotation, place = _pose(bones.parent, bones.joint_m, turns, np.zeros_like(turns) if bends is None else bends)
    return Pose(rotation=rotation, place_m=place)


def bend(
    bones: Bones,
    posed: Pose,
    points: Float32[np.ndarray, "N 3"],
    rows: Int32[np.ndarray, "N W"],
    weights: Float32[np.ndarray, "N W"],
) -> Float32[np.ndarray, "N 3"]:
    """Displacement of points, each the weighted mean of where its bones `rows` would carry it [m].

    A point whose weights are all 0 stays where it is.
    """
    # x' = Σ w (R x + t) with t = joint' - R joint
    shift = posed.place_m - np.einsum("bij,bj->bi", posed.rotation, bones.joint_m)
    moved = np.empty_like(points)
    in_bands(_bend, len(points), posed.rotation, shift.astype(np.float32), points, rows, weights, moved)
    return moved


@compiled
@no_type_check
def _pose(parent, joint, turns, bends):
    frame = np.empty((len(parent), 3, 3), np.float32)  # A
    rotation = np.empty((len(parent), 3, 3), np.float32)
    place = np.empty((len(parent), 3), np.float32)
    for b in range(len(parent)):
        a = parent[b]
        own, bend = _rotation(turns[b]), _rotation(bends[b])
        if a < 0:
            frame[b] = bend
        else:
            _multiply(frame[a], bend, frame[b])
        _multiply(frame[b], own, rotation[b])
        if a < 0:
            place[b] = joint[b]
            continue
        for i in range(3):
            place[b, i] = place[a, i]
            for j in range(3):
                place[b, i] += rotation[a, i, j] * (joint[b, j] - joint[a, j])
    return rotation, place


@compiled
@no_type_check
def _rotation(turn):
    x, y, z = turn
    angle = np.sqrt(x * x + y * y + z * z)
    # Rodrigues: R = cos a I + (sin a / a) [θ]× + (1 - cos a)/a² θ θᵀ
    c = np.cos(angle)
    s = np.sin(angle) / angle if angle > 1e-4 else 1 - angle * angle / 6
    d = (1 - c) / (angle * angle) if angle > 1e-2 else 0.5 - angle * angle / 24
    matrix = np.empty((3, 3), np.float32)
    matrix[0] = (c + d * x * x, d * x * y - s * z, d * x * z + s * y)
    matrix[1] = (d * x * y + s * z, c + d * y * y, d * y * z - s * x)
    matrix[2] = (d * x * z - s * y, d * y * z + s * x, c + d * z * z)
    return matrix


@compiled
@no_type_check
def _multiply(left, right, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = left[i, 0] * right[0, j] + left[i, 1] * right[1, j] + left[i, 2] * right[2, j]


@compiled
@no_type_check
def _bend(first, end, rotation, shift, points, rows, weights, moved):
    for n in range(first, end):
        x, y, z = points[n]
        carried = False
        for j in range(rows.shape[1]):
            carried |= weights[n, j] > 0
        for i in range(3):
            if not carried:
                moved[n, i] = 0
                continue
            total = np.float32(0)
            for j in range(rows.shape[1]):
                w = weights[n, j]
                if w > 0:
                    b = rows[n, j]
                    r = rotation[b, i]
                    total += w * (r[0] * x + r[1] * y + r[2] * z + shift[b, i])
            moved[n, i] = total - points[n, i]
