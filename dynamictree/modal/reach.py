"""Locality of a push: modes span the whole tree, so each group of forces has a weight per bone.

    w(b) = exp(−(c(b) / falloff)²)

c(b) is the length of the way along the bones from the middle of the pushed bone to the end of b, where

- going outward from where the push began is free: what the pushed bone carries rides with it;
- going towards the root costs its length: what carries it moves less, the nearer to the root the less;
- going outward again costs `OUTWARD` times its length: other branches barely move;
- the ground is no way.

The plain answer of a point is w Σ_k φ_k q_k. A bone on the way to the root turns so that its end goes there:

    θ_b = w_b t_b + r × (w_b − w_a) u_b / |r|²,      t_b = Re Σ_k θ_{b,k} q_k

with r from its foot to the foot of the next on the way, and u_b how far the modes move its foot. Another branch rides
on what carries it: θ_b = θ_a + w_b (t_b − t_a).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int8

from dynamictree.errors import InputError
from dynamictree.rig.pose import GROUND, Skeleton

OUTWARD = 32.0
OTHER, CARRIES, HANGS = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class Reach:
    """How the B bones take part in a push at one of them."""

    weights: Float64[np.ndarray, " B"]
    kind: Int8[np.ndarray, " B"]  # CARRIES the pushed bone, or is it; HANGS on it; OTHER
    end_m: Float64[np.ndarray, "B 3"]  # of what carries it, the foot of the next on the way


def reach_of(skeleton: Skeleton, bone: int, falloff_m: float) -> Reach:
    """How far a push at a bone reaches.

    Raises:
        InputError: the falloff is no length.
    """
    if not (np.isfinite(falloff_m) and falloff_m > 0):
        raise InputError(f"falloff_m is {falloff_m}; it must be positive and finite")
    foot, length = skeleton.foot_m.astype(np.float64), np.linalg.norm(skeleton.reach_m, axis=1).astype(np.float64)
    cost, kind = np.full(len(skeleton), np.inf), np.full(len(skeleton), OTHER, np.int8)
    end = foot + skeleton.reach_m
    way, at = 0.0, bone
    while at >= 0:
        cost[at], kind[at] = way, CARRIES
        way += (0.5 if at == bone else 1.0) * float(np.linalg.norm(end[at] - foot[at]))
        carrier = int(skeleton.parent[at])
        if carrier >= 0:
            end[carrier] = foot[at]
        at = carrier
    for level in skeleton.levels:
        above = skeleton.parent[level]
        hangs = (kind[level] == OTHER) & ((above == bone) | (kind[above] == HANGS))
        kind[level][hangs] = HANGS
        outward = np.where(hangs, 0, np.where(above == GROUND, np.inf, OUTWARD * length[level]))
        cost[level] = np.where(kind[level] == CARRIES, cost[level], cost[above] + outward)
    return Reach(weights=np.exp(-((cost / falloff_m) ** 2)), kind=kind, end_m=end)
