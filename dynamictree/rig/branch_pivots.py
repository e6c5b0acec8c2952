"""Where each vertex' branch begins: what a foliage shader turns it about."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64

from dynamictree.rig.branch_groups import branch_orders, branches_of
from dynamictree.rig.rig import Rig
from dynamictree.rig.skin import reduced

MOST_BONES = 256
"""Shaders look up a pivot for each branch in a small texture; finer branches hang on these."""


@dataclass(frozen=True, kw_only=True)
class BranchPivots:
    """The foot of each vertex' branch, and the branch's order: 0 is the trunk. Then the E branches as a hierarchy."""

    pivot_m: Float32[np.ndarray, "N 3"]  # of the bone that carries most of the vertex
    order: Int64[np.ndarray, " N"]
    branch: Int64[np.ndarray, " N"]
    foot_m: Float32[np.ndarray, "E 3"]
    parent: Int64[np.ndarray, " E"]  # its own number at a root


def branch_pivots(rig: Rig, vertices: Float32[np.ndarray, "N 3"]) -> BranchPivots:
    """Pivot and order of the bone that carries most of each vertex, of the `MOST_BONES` that move most."""
    few = reduced(rig, vertices, MOST_BONES)
    skeleton, weights = few.skeleton, few.vertices
    strongest = weights.rows[np.arange(len(weights)), weights.shares.argmax(axis=1)]
    branch, first = branches_of(skeleton.parent)
    above = skeleton.parent[first]
    return BranchPivots(
        pivot_m=skeleton.foot_m[strongest],
        order=branch_orders(skeleton.parent)[strongest],
        branch=branch[strongest],
        foot_m=skeleton.foot_m[first],
        parent=np.where(above < 0, np.arange(len(first)), branch[np.maximum(above, 0)]),
    )
