"""Convert a rig to joints with 16-bit keys, for files and engines: all bones, or the most important ones."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64

from dynamictree.parallel import on_cores
from dynamictree.rig.pose import Poses, Skeleton, Weights, by_depth, carried, poses
from dynamictree.rig.rig import Rig
from dynamictree.rotation import matrix_quaternions, quaternion_matrices
from dynamictree.skin import JOINTS_PER_VERTEX, Skin, SkinSummary
from dynamictree.spectrum import STEPS, bin_weights


def skin_of(rig: Rig, vertices: Float32[np.ndarray, "N 3"], num_joints: int) -> tuple[Skin, SkinSummary]:
    """Create a skin of at most `num_joints` joints over the loop, with a summary of its error against the rig.

    With as many joints as bones it equals the rig to the precision of the keys, with the same weights.
    """
    few = reduce_rig(rig, vertices, num_joints)
    skeleton = few.skeleton
    phases = np.arange(rig.num_frames) / rig.num_frames
    rotation = poses(skeleton, np.stack(list(few.theta(phases)))).rotation
    width = few.vertices.rows.shape[1]
    padding = ((0, 0), (0, JOINTS_PER_VERTEX - width))
    skin = Skin(
        parent=skeleton.parent,
        joint_m=skeleton.foot_m,
        rows=np.pad(few.vertices.rows, padding),
        weights=np.pad(few.vertices.shares, padding),
        turns=_keys(skeleton, rotation),
    )
    stance, whole = joint_poses(skin), poses(rig.skeleton, np.stack(list(rig.theta(phases))))

    def squares(frame: int) -> tuple[float, float, float]:
        """Return the sum of the squared displacements, and sum and maximum of the squared errors [m²]."""
        moved = carried(rig.skeleton, whole, frame, vertices, rig.vertices)
        gap = ((carried(skeleton, stance, frame, vertices, few.vertices) - moved) ** 2).sum(axis=1)
        return float((moved**2).sum()), float(gap.sum()), float(gap.max())

    totals, gaps, maxima = zip(*on_cores(squares, range(rig.num_frames)), strict=True)
    total, missing, largest = sum(totals), sum(gaps), max(maxima)
    summary = SkinSummary(
        num_joints=len(skin.parent),
        num_keys=rig.num_frames + 1,
        relative_error=float(np.sqrt(missing / total)) if total > 0 else 0.0,
        rms_error_m=float(np.sqrt(missing / (rig.num_frames * len(vertices)))),
        max_error_m=float(np.sqrt(largest)),
    )
    return skin, summary


def joint_poses(skin: Skin) -> Poses:
    """Compute the poses of the joints at every frame, as a player does."""
    foot, rotation = skin.joint_m.astype(np.float64), _matrices(skin.turns.astype(np.float64))
    place = np.tile(foot, (len(rotation), 1, 1))
    for joint, above in enumerate(skin.parent.tolist()):
        if above >= 0:
            place[:, joint] = place[:, above] + rotation[:, above] @ (foot[joint] - foot[above])
            rotation[:, joint] = rotation[:, above] @ rotation[:, joint]
    return Poses(rotation=rotation, place_m=place)


def _keys(skeleton: Skeleton, rotation: Float64[np.ndarray, "T B 3 3"]) -> Float32[np.ndarray, "T B 4"]:
    """Quantize rotations relative to the parents to 16 bits; children compensate their parents' errors."""
    turns = np.tile(np.array([1.0, 0, 0, 0]), (*rotation.shape[:2], 1))
    stored = np.tile(np.eye(3), (*rotation.shape[:2], 1, 1))
    for level in skeleton.levels:
        above = stored[:, skeleton.above[level]]
        wanted = matrix_quaternions((above.swapaxes(-1, -2) @ rotation[:, level]).reshape(-1, 3, 3))
        wanted = wanted.reshape(len(turns), -1, 4)
        flips = np.cumsum((wanted[1:] * wanted[:-1]).sum(axis=2) < 0, axis=0)  # signs follow those of the frame before
        wanted[1:] *= np.where(flips % 2 == 1, -1.0, 1.0)[:, :, None]
        turns[:, level] = np.rint(STEPS * wanted) / STEPS
        stored[:, level] = above @ _matrices(turns[:, level])
    return turns.astype(np.float32)


def _matrices(turns: Float64[np.ndarray, "T n 4"]) -> Float64[np.ndarray, "T n 3 3"]:
    unit = turns / np.linalg.norm(turns, axis=2, keepdims=True)
    return quaternion_matrices(unit.reshape(-1, 4)).reshape(*turns.shape[:2], 3, 3)


def reduce_rig(rig: Rig, vertices: Float32[np.ndarray, "N 3"], num_bones: int) -> Rig:
    """Reduce a rig to `num_bones` bones, those whose rotation relative to their parent moves the mesh most."""
    skeleton = rig.skeleton
    if len(skeleton) <= num_bones:
        return rig
    cost = _losses(rig, vertices)
    cost[0] = np.inf
    remaining = np.sort(np.argsort(-cost, kind="stable")[:num_bones])
    target = np.arange(len(skeleton))
    stays = np.zeros(len(skeleton), np.bool_)
    stays[remaining] = True
    for bone in np.flatnonzero(~stays):  # parents come before children
        target[bone] = target[skeleton.parent[bone]]
    number = np.searchsorted(remaining, target).astype(np.int32)
    parent = np.where(remaining == 0, -1, number[skeleton.above[remaining]]).astype(np.int32)
    few = Skeleton(
        parent=parent,
        foot_m=skeleton.foot_m[remaining],
        reach_m=skeleton.reach_m[remaining],
        in_surface=skeleton.in_surface[remaining],
    )
    ordered, order = by_depth(few)
    place = np.argsort(order).astype(np.int32)
    return replace(
        rig,
        skeleton=ordered,
        turns=rig.turns[remaining][order],
        vertices=_merged(rig.vertices, place[number]),
        voxels=_merged(rig.voxels, place[number]),
    )


def _losses(rig: Rig, vertices: Float32[np.ndarray, "N 3"]) -> Float64[np.ndarray, " B"]:
    """Compute the squared error [m²] of letting each bone rotate like its parent, to first order."""
    skeleton, count = rig.skeleton, len(rig.skeleton)
    bone = rig.vertices.rows[np.arange(len(vertices)), rig.vertices.shares.argmax(axis=1)]
    arm = ((vertices - skeleton.foot_m[bone]).astype(np.float64) ** 2).sum(axis=1)
    lever, carries = np.bincount(bone, arm, count), np.bincount(bone, minlength=count)
    for child in range(count - 1, 0, -1):
        above = skeleton.parent[child]
        foot = ((skeleton.foot_m[child] - skeleton.foot_m[above]).astype(np.float64) ** 2).sum()
        carries[above] += carries[child]
        lever[above] += carries[child] * foot
    apart = np.abs(rig.turns - rig.turns[skeleton.above]) ** 2
    return np.asarray(lever * (apart.sum(axis=2) @ bin_weights(rig.turns.shape[1], rig.num_frames)))


def _merged(weights: Weights, number: Int32[np.ndarray, " B"]) -> Weights:
    """Renumber the bones of weights, and add the shares of merged bones."""
    rows, shares = number[weights.rows], weights.shares.copy()
    for later in range(1, rows.shape[1]):
        for earlier in range(later):
            same: Int64[np.ndarray, " n"] = np.flatnonzero(rows[:, later] == rows[:, earlier])
            shares[same, earlier] += shares[same, later]
            shares[same, later] = 0
    return Weights(rows=rows, shares=shares)
