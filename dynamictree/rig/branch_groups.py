"""Properties of joints for engines that animate a tree themselves: branch orders, bending angles, capsules."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64

from dynamictree.rig.rig import Rig
from dynamictree.skin import Skin

MAX_ORDER = 3  # order of all finer branches too
_THINNEST_M = 0.005
_INSIDE = 0.5  # share of a bone's vertices inside its capsule; the others are twigs that stick out


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """Capsule carried by a joint: points within a radius of a segment [m]. Length and radius are those at rest."""

    joint: int
    start_m: Float32[np.ndarray, "3"]
    end_m: Float32[np.ndarray, "3"]
    radius_m: float


def branch_orders(parent: Int32[np.ndarray, " B"]) -> Int64[np.ndarray, " B"]:
    """Return the branch order of each joint: 0 for the trunk, 1 for branches from the trunk, and so on.

    A joint's branch continues in the child that carries most joints.
    """
    order, size = np.zeros(len(parent), np.int64), np.ones(len(parent), np.int64)
    for joint in range(len(parent) - 1, -1, -1):  # children come after their parents
        if parent[joint] >= 0:
            size[parent[joint]] += size[joint]
    heir = {parent[joint]: joint for joint in np.lexsort((-np.arange(len(parent)), size))}  # the largest is last
    for joint, above in enumerate(parent):
        if above >= 0:
            order[joint] = order[above] if heir[above] == joint else min(order[above] + 1, MAX_ORDER)
    return order


def bending_rad(skin: Skin) -> Float64[np.ndarray, " B"]:
    """Compute the root mean square rotation of each joint relative to its parent over the loop [rad]."""
    angle = 2 * np.arctan2(np.linalg.norm(skin.turns[:, :, 1:], axis=2), np.abs(skin.turns[:, :, 0]))
    return np.asarray(np.sqrt((angle**2).mean(axis=0)), np.float64)


def capsules(rig: Rig, vertices: Float32[np.ndarray, "N 3"], wood: Bool[np.ndarray, " N"]) -> list[Capsule]:
    """Create a capsule for each bone that carries wood; the median distance of its vertices is the radius."""
    bones, weights = rig.skeleton, rig.vertices
    strongest = weights.rows[np.arange(len(vertices)), weights.shares.argmax(axis=1)]
    capsules_of_wood = []
    for joint in range(1, len(bones.parent)):
        own = vertices[wood & (strongest == joint)].astype(np.float64)
        if len(own):
            start, reach = bones.foot_m[joint].astype(np.float64), bones.reach_m[joint].astype(np.float64)
            along = np.clip((own - start) @ reach / max(float(reach @ reach), 1e-12), 0, 1)
            distance = np.linalg.norm(own - start - along[:, None] * reach, axis=1)
            capsules_of_wood.append(
                Capsule(
                    joint=joint,
                    start_m=bones.foot_m[joint],
                    end_m=bones.foot_m[joint] + bones.reach_m[joint],
                    radius_m=max(float(np.quantile(distance, _INSIDE)), _THINNEST_M),
                )
            )
    return capsules_of_wood
