"""Rotations of the rig's bones under forces, from modal coordinates, for the whole tree or locally."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import no_type_check

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64, Int32, Int64

from dynamictree.modal.reach import ROLE_CARRIED, ROLE_CARRIER, Reach
from dynamictree.parallel import compiled
from dynamictree.rig.pose import GROUND, Skeleton, Weights
from dynamictree.rig.rig import Rig
from dynamictree.spectrum import bin_weights


@dataclass(frozen=True, kw_only=True)
class Bones:
    """B bones of a rig, and its V voxels."""

    skeleton: Skeleton
    shapes: Complex64[np.ndarray, "B M 3"]  # θ per unit of each coordinate [rad]
    voxels: Weights
    stem: Int32[np.ndarray, " B"]  # the bone itself, or the carrier of a card
    of_voxel: Int32[np.ndarray, " V"]  # stem bone that carries most of each voxel
    of_vertex: Int32[np.ndarray, " N"]  # bone that carries most of each vertex
    num_carried: Int64[np.ndarray, " B"]  # number of voxels that each bone carries, its own included

    @cached_property
    def parts(self) -> Float32[np.ndarray, "_ _"]:
        """θ per unit of each coordinate's real part, then imaginary part [2M, 3B]: Re θq = Re θ Re q - Im θ Im q."""
        shapes = self.shapes.transpose(1, 0, 2).reshape(self.shapes.shape[1], -1)
        return np.concatenate([shapes.real, -shapes.imag])


def bones_of(rig: Rig) -> Bones:
    """Prepare the bones of a rig for forces."""
    parent = rig.skeleton.parent
    bends = np.zeros(len(parent), np.bool_)
    bends[rig.vertices.rows[rig.vertices.shares[:, 1] > 0, 0]] = True
    bends[parent[1:]] = True
    stem = np.arange(len(parent), dtype=np.int32)
    for bone in np.flatnonzero(~bends):
        stem[bone] = stem[max(parent[bone], GROUND)]
    rows = stem[rig.voxels.rows]
    share = (rig.voxels.shares[:, None] * (rows[:, :, None] == rows[:, None])).sum(axis=2)
    of_voxel = rows[np.arange(len(rows)), share.argmax(axis=1)]
    carried = np.bincount(of_voxel, minlength=len(parent))
    for level in reversed(rig.skeleton.levels):
        np.add.at(carried, rig.skeleton.above[level], carried[level])
    often = bin_weights(rig.turns.shape[1], rig.num_frames)[1:, None]
    return Bones(
        skeleton=rig.skeleton,
        shapes=np.ascontiguousarray(rig.turns[:, 1:] * often, np.complex64),
        voxels=rig.voxels,
        stem=stem,
        of_voxel=of_voxel,
        of_vertex=rig.vertices.rows[np.arange(len(rig.vertices)), rig.vertices.shares.argmax(axis=1)],
        num_carried=carried,
    )


def turns_of(
    bones: Bones, reaches: Sequence[Reach | None], q: Complex128[np.ndarray, "G M"]
) -> Float64[np.ndarray, "B 3"]:
    """Compute θ of every bone from the groups' coordinates; a group without a reach moves the whole tree."""
    skeleton = bones.skeleton
    turns = np.zeros((len(skeleton), 3))
    for reach, coordinates in zip(reaches, q, strict=True):
        q_parts = np.concatenate([coordinates.real, coordinates.imag]).astype(np.float32)
        # a product by BLAS takes four times as long, and its threads spin on after it
        own = np.einsum("mn,m->n", bones.parts, q_parts).reshape(-1, 3).astype(np.float64)
        if reach is not None:
            foot = skeleton.foot_m.astype(np.float64)
            own = _local(skeleton.above, foot, reach.end_m, reach.weights, reach.kind, own)
        turns += own
    return turns


@compiled
@no_type_check  # numba cannot compile a type-checked function
def _local(above, foot, end, weights, kind, own):
    """Compute a group's rotations, see `reach.py`."""
    turns, shift = np.zeros_like(own), np.zeros_like(own)
    for b in range(1, len(own)):
        a = above[b]
        shift[b] = shift[a] + np.cross(own[a], foot[b] - foot[a])  # displacement of the foot without locality
        if kind[b] == ROLE_CARRIED:
            turns[b] = own[b]
        elif kind[b] == ROLE_CARRIER:
            arm = end[b] - foot[b]
            gain = (weights[b] - weights[a]) / max((arm**2).sum(), 1e-12)
            turns[b] = weights[b] * own[b] + gain * np.cross(arm, shift[b])
        else:
            turns[b] = turns[a] + weights[b] * (own[b] - own[a])
    return turns
