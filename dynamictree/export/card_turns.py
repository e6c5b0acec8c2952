"""Leaf cards and other small parts as rigid bodies: how far each turns in each mode, for engines that add modes.

A sum of modes that turns a card also enlarges it. So each mode of a card is split into the motion of its pivot, the
vertex that moves least, and a turn about it, the least-squares rotation vector θ of the mode. Both are added over the
modes, and only then the card is turned: by atan |θ| about θ, which is the rotation nearest to the sum and never more
than a right angle. With c = 1 / sqrt(1 + |θ|²), an arm r from the pivot becomes

    c r + c θ × r + c² / (1 + c) (θ · r) θ.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Int64

from dynamictree.devoxelize.attachment import SMALL_PART_VOXELS
from dynamictree.devoxelize.inextensible import CARD_VERTICES
from dynamictree.mesh import TriangleMesh, connected_parts, part_bounds, weld

FINENESS = 128
"""Voxels along the tree that say which parts are small, whatever the grid of the motion."""


@dataclass(frozen=True, kw_only=True)
class CardTurns:
    """Modes of the vertices: of those in cards, the modes of their pivot, and the turn about it."""

    moved: Complex64[np.ndarray, "N K 3"]  # [m]
    turn: Complex64[np.ndarray, "N K 3"]  # θ; 0 in no card
    arm_m: Float32[np.ndarray, "N 3"]  # from the pivot; 0 in no card


def card_turns(mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"]) -> CardTurns | None:
    """Split the modes of the mesh's cards [m]; `None` where it has none."""
    part = _card_of(mesh)
    rows = np.flatnonzero(part >= 0)
    if len(rows) == 0:
        return None
    rows = rows[np.argsort(part[rows], kind="stable")]
    starts = np.flatnonzero(np.diff(part[rows], prepend=-1))
    card = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(rows))))
    power = (np.abs(coefficients[rows]) ** 2).sum(axis=(1, 2))
    pivot = rows[np.lexsort([power, card])[starts]]
    arm = mesh.vertices[rows].astype(np.float64) - mesh.vertices[pivot][card]
    squares = np.add.reduceat(arm[:, :, None] * arm[:, None], starts)
    inertia = np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(3) - squares
    swing = coefficients[rows] - coefficients[pivot][card]
    moment = np.add.reduceat(np.cross(arm[:, None], swing), starts)  # [C, K, 3]
    theta = np.einsum("cij,ckj->cki", np.linalg.pinv(inertia, rcond=1e-4, hermitian=True), moment)
    moved, turn = coefficients.copy(), np.zeros_like(coefficients)
    moved[rows], turn[rows] = coefficients[pivot][card], theta[card]
    arm_m = np.zeros_like(mesh.vertices)
    arm_m[rows] = arm
    return CardTurns(moved=moved, turn=turn, arm_m=arm_m)


def _card_of(mesh: TriangleMesh) -> Int64[np.ndarray, " N"]:
    """Number of the small part that a vertex is in; -1 for wood, and for a part that stands on the ground."""
    surface, vertex = weld(mesh)
    part = connected_parts(surface.faces, surface.num_vertices)
    low, high = part_bounds(part, surface.vertices)
    voxel_m = float((high.max(axis=0) - low.min(axis=0)).max()) / FINENESS
    small = (high - low).max(axis=1) < SMALL_PART_VOXELS * voxel_m
    stands = ~small & (low[:, 2] < low[:, 2].min() + voxel_m)
    is_card = (small | (np.bincount(part) <= CARD_VERTICES)) & ~stands
    card: Int64[np.ndarray, " N"] = np.where(is_card[part], part, -1)[vertex].astype(np.int64)
    return card
