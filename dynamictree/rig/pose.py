"""Forward kinematics of a skeleton, and skinning of points. The equations are in the package's docstring."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64

from dynamictree.parallel import compiled, in_bands

GROUND = 0
"""Bone that never moves; it carries everything that is no plant."""


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """B bones in the order of their depth, so that parents come before children; the first is the ground."""

    parent: Int32[np.ndarray, " B"]  # -1 for the ground
    foot_m: Float32[np.ndarray, "B 3"]  # pivot of a bone, carried by its parent
    reach_m: Float32[np.ndarray, "B 3"]  # vector from the foot to the bone's end
    in_surface: Bool[np.ndarray, " B"]  # bones of a crown that is one surface

    def __len__(self) -> int:
        return len(self.parent)

    @property
    def depths(self) -> Int64[np.ndarray, " B"]:
        """Number of ancestors of each bone; the bones may be in any order."""
        above, depth = self.parent, np.zeros(len(self), np.int64)
        while above.max(initial=-1) >= 0:
            depth += above >= 0
            above = np.where(above < 0, -1, self.parent[above])
        return depth

    @property
    def above(self) -> Int32[np.ndarray, " B"]:
        """Parent of each bone; the ground's is itself."""
        return np.asarray(np.maximum(self.parent, 0))

    @property
    def directions(self) -> Float32[np.ndarray, "B 3"]:
        """Unit vector from each foot to the bone's end; its swing rotates with the wind's direction.

        It is up for bones without length, and in a surface, whose bones rotate alike so that it does not tear.
        """
        length = np.linalg.norm(self.reach_m, axis=1, keepdims=True)
        upward = (length == 0) | self.in_surface[:, None]
        up = np.array([0, 0, 1], np.float32)
        return np.asarray(np.where(upward, up, self.reach_m / np.maximum(length, 1e-12)), np.float32)

    def take(self, rows: Int64[np.ndarray, " b"], parent: Int32[np.ndarray, " b"]) -> "Skeleton":
        """Return some of the bones, with new parents."""
        values = self.foot_m[rows], self.reach_m[rows], self.in_surface[rows]
        return Skeleton(parent=parent, foot_m=values[0], reach_m=values[1], in_surface=values[2])

    @cached_property
    def levels(self) -> list[slice]:
        """Slices of the bones of each depth, from 1."""
        edges = np.append(np.flatnonzero(np.diff(self.depths)) + 1, len(self.parent)).tolist()
        return [slice(first, end) for first, end in pairwise(edges)]


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Skinning weights: bones that carry each of n points, and their shares, which sum to 1."""

    rows: Int32[np.ndarray, "n W"]
    shares: Float32[np.ndarray, "n W"]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, some: slice) -> "Weights":
        return Weights(rows=self.rows[some], shares=self.shares[some])


@dataclass(frozen=True, kw_only=True)
class Poses:
    """Poses of all bones at T moments: a point x of bone b moves to rotation (x - foot) + place."""

    rotation: Float64[np.ndarray, "T B 3 3"]
    place_m: Float64[np.ndarray, "T B 3"]


def by_depth(skeleton: Skeleton) -> tuple[Skeleton, Int32[np.ndarray, " B"]]:
    """Sort bones by depth; return them and each one's previous index."""
    order = np.argsort(skeleton.depths, kind="stable")
    parent = np.where(skeleton.parent < 0, -1, np.argsort(order)[skeleton.parent])[order].astype(np.int32)
    return skeleton.take(order, parent), order.astype(np.int32)


def poses(skeleton: Skeleton, theta: Float32[np.ndarray, "T B 3"]) -> Poses:
    """Compute the poses of the bones from their θ [rad]."""
    foot, turns = skeleton.foot_m.astype(np.float64), np.ascontiguousarray(theta, np.float64)
    rotation, place = np.empty((*theta.shape, 3)), np.empty(theta.shape)
    in_bands(_pose, len(theta), skeleton.above, foot, turns, rotation, place)
    return Poses(rotation=rotation, place_m=place)


def carried(
    skeleton: Skeleton, stance: Poses, moment: int, points: Float32[np.ndarray, "n 3"], weights: Weights
) -> Float32[np.ndarray, "n 3"]:
    """Compute the displacement of points at one moment of the poses [m]."""
    rotation = stance.rotation[moment]
    shift = stance.place_m[moment] - np.einsum("bij,bj->bi", rotation, skeleton.foot_m)  # x' = Σ w (R x + shift)
    less_one = np.dstack([rotation - np.eye(3), shift])  # (R - 1) x + shift retains the digits of small motions
    moved = np.empty((len(points), 3), np.float32)
    m = less_one.reshape(-1, 12)
    in_bands(_carry, len(points), m, points, weights.rows, weights.shares, moved, rows_per_thread=1000)
    return moved


@compiled
@no_type_check  # numba cannot compile a type-checked function
def _pose(first, end, above, foot, theta, rotation, place):
    for t in range(first, end):
        for b in range(len(foot)):
            x, y, z = theta[t, b]
            c = 1 / np.sqrt(1 + x * x + y * y + z * z)
            d = c * c / (1 + c)
            r = rotation[t, b]
            r[0, 0], r[0, 1], r[0, 2] = c + d * x * x, d * x * y - c * z, d * x * z + c * y
            r[1, 0], r[1, 1], r[1, 2] = d * x * y + c * z, c + d * y * y, d * y * z - c * x
            r[2, 0], r[2, 1], r[2, 2] = d * x * z - c * y, d * y * z + c * x, c + d * z * z
            a = above[b]
            for i in range(3):
                if a == b:
                    place[t, b, i] = foot[b, i]
                    continue
                q = rotation[t, a, i]
                u, v, w = foot[b, 0] - foot[a, 0], foot[b, 1] - foot[a, 1], foot[b, 2] - foot[a, 2]
                place[t, b, i] = place[t, a, i] + q[0] * u + q[1] * v + q[2] * w


@compiled
@no_type_check
def _carry(first, end, m, points, rows, shares, moved):
    for n in range(first, end):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        u = v = w = 0.0
        for j in range(rows.shape[1]):
            b, share = rows[n, j], shares[n, j]
            if share > 0:
                u += share * (m[b, 0] * x + m[b, 1] * y + m[b, 2] * z + m[b, 3])
                v += share * (m[b, 4] * x + m[b, 5] * y + m[b, 6] * z + m[b, 7])
                w += share * (m[b, 8] * x + m[b, 9] * y + m[b, 10] * z + m[b, 11])
        moved[n, 0], moved[n, 1], moved[n, 2] = u, v, w
