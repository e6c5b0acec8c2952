"""Convert a rig to joints with 16-bit keys, for files and engines: all bones, or the most important ones."""

from dataclasses import replace
from functools import partial

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
    poses_at_once = 500_000  # 50 MB
    few, num_frames = reduce_rig(rig, vertices, num_joints), rig.num_frames
    turns = np.empty((num_frames, len(few.skeleton), 4), np.float32)
    last, squares = np.tile(np.eye(1, 4, dtype=np.float32), (len(few.skeleton), 1)), list[tuple[float, float, float]]()
    for some in np.array_split(np.arange(num_frames), -(-num_frames * len(rig.skeleton) // poses_at_once)):
        both = (rig, few) if few is not rig else (rig,)
        stances = [poses(one.skeleton, np.stack(list(one.theta(some / num_frames)))) for one in both]
        turns[some], stance = _keys(few.skeleton, stances[-1].rotation, last)
        last = turns[some[-1]]
        squares += on_cores(partial(_squares, (rig, few), (stances[0], stance), vertices), range(len(some)))
    totals, gaps, maxima = zip(*squares, strict=True)
    total, missing, largest = sum(totals), sum(gaps), max(maxima)
    padding = ((0, 0), (0, JOINTS_PER_VERTEX - few.vertices.rows.shape[1]))
    skin = Skin(
        parent=few.skeleton.parent,
        joint_m=few.skeleton.foot_m,
        rows=np.pad(few.vertices.rows, padding),
        weights=np.pad(few.vertices.shares, padding),
        turns=turns,
    )
    summary = SkinSummary(
        num_joints=len(skin.parent),
        num_keys=num_frames + 1,
        relative_error=float(np.sqrt(missing / total)) if total > 0 else 0.0,
        rms_error_m=float(np.sqrt(missing / (num_frames * len(vertices)))),
        max_error_m=float(np.sqrt(largest)),
    )
    return skin, summary


def _squares(
    rigs: tuple[Rig, Rig], stances: tuple[Poses, Poses], vertices: Float32[np.ndarray, "N 3"], frame: int
) -> tuple[float, float, float]:
    """Return the sum of the squared displacements, and sum and maximum of the second rig's squared errors [m²]."""
    moved, other = (
        carried(rig.skeleton, stance, frame, vertices, rig.vertices) for rig, stance in zip(rigs, stances, strict=True)
    )
    gap = ((other - moved) ** 2).sum(axis=1)
    return float((moved**2).sum()), float(gap.sum()), float(gap.max())


def _keys(
    skeleton: Skeleton, rotation: Float64[np.ndarray, "T B 3 3"], last: Float32[np.ndarray, "B 4"]
) -> tuple[Float64[np.ndarray, "T B 4"], Poses]:
    """Quantize rotations relative to the parents to 16 bits; children compensate their parents' errors.

    `last` are the keys before, whose signs the first follow. The poses are those of a player.
    """
    foot = skeleton.foot_m.astype(np.float64)
    turns = np.tile(np.array([1.0, 0, 0, 0]), (*rotation.shape[:2], 1))
    stored, place = np.tile(np.eye(3), (*rotation.shape[:2], 1, 1)), np.tile(foot, (len(rotation), 1, 1))
    for level in skeleton.levels:
        parent = skeleton.above[level]
        above = stored[:, parent]
        wanted = matrix_quaternions((above.swapaxes(-1, -2) @ rotation[:, level]).reshape(-1, 3, 3))
        wanted = wanted.reshape(len(turns), -1, 4)
        before = np.concatenate([last[None, level], wanted[:-1]])
        flips = np.cumsum((wanted * before).sum(axis=2) < 0, axis=0)
        turns[:, level] = np.rint(STEPS * np.where(flips % 2 == 1, -1.0, 1.0)[:, :, None] * wanted) / STEPS
        stored[:, level] = above @ _matrices(turns[:, level])
        place[:, level] = place[:, parent] + (above @ (foot[level] - foot[parent])[..., None])[..., 0]
    return turns, Poses(rotation=stored, place_m=place)


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
    ordered, order = by_depth(skeleton.take(remaining, parent))
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
