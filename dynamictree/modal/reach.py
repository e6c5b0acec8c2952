"""Locality of a push: since modes span the whole tree, each group of forces has a weight per bone.

    w(b) = exp(−(c(b) / falloff)²)

c(b) is the length of the path along the bones from the middle of the pushed bone to the end of b, where

- steps outward from the pushed bone cost nothing: bones that it carries move with it;
- steps towards the root cost their length: its carriers move less the nearer they are to the root;
- steps outward from these cost `OUTWARD_COST` times their length: other branches barely move;
- no path leads across the ground.

A point's plain response is w Σ_k φ_k q_k. A bone on the path to the root rotates so that its end follows it:

    θ_b = w_b t_b + r × (w_b − w_a) u_b / |r|²,      t_b = Re Σ_k θ_{b,k} q_k

with r from its foot to the foot of the next bone on the path, and u_b the displacement of its foot by the modes.
Another branch moves with its carrier: θ_b = θ_a + w_b (t_b − t_a).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int8

from dynamictree.errors import InputError
from dynamictree.rig.pose import GROUND, Skeleton

OUTWARD_COST = 32.0
ROLE_OTHER, ROLE_CARRIER, ROLE_CARRIED = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Weights and roles of the B bones in a push at one of them."""

    weights: Float64[np.ndarray, " B"]
    kind: Int8[np.ndarray, " B"]  # ROLE_CARRIER (the pushed bone, its carriers), ROLE_CARRIED, ROLE_OTHER
    end_m: Float64[np.ndarray, "B 3"]  # end of each bone; for carriers, the foot of the next bone on the path


def reach_of(skeleton: Skeleton, bone: int, falloff_m: float) -> Reach:
    """Compute the reach of a push at a bone.

    Raises:
        InputError: the falloff is not a positive length.
    """
    if not (np.isfinite(falloff_m) and falloff_m > 0):
        raise InputError(f"falloff_m is {falloff_m}; it must be positive and finite")
    foot, length = skeleton.foot_m.astype(np.float64), np.linalg.norm(skeleton.reach_m, axis=1).astype(np.float64)
    cost, kind = np.full(len(skeleton), np.inf), np.full(len(skeleton), ROLE_OTHER, np.int8)
    end = foot + skeleton.reach_m
    way, at = 0.0, bone
    while at >= 0:
        cost[at], kind[at] = way, ROLE_CARRIER
        way += (0.5 if at == bone else 1.0) * float(np.linalg.norm(end[at] - foot[at]))
        carrier = int(skeleton.parent[at])
        if carrier >= 0:
            end[carrier] = foot[at]
        at = carrier
    for level in skeleton.levels:
        above = skeleton.parent[level]
        hangs = (kind[level] == ROLE_OTHER) & ((above == bone) | (kind[above] == ROLE_CARRIED))
        kind[level][hangs] = ROLE_CARRIED
        outward = np.where(hangs, 0, np.where(above == GROUND, np.inf, OUTWARD_COST * length[level]))
        cost[level] = np.where(kind[level] == ROLE_CARRIER, cost[level], cost[above] + outward)
    return Reach(weights=np.exp(-((cost / falloff_m) ** 2)), kind=kind, end_m=end)
