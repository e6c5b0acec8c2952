"""Poses without stretch: large motions bend the mesh and keep edge lengths, frame by frame.

A spectrum adds displacements, and a displacement that would turn a branch by an angle stretches it once the angle is
large. So each frame is read as directions and turns, and the pose is built from these again. With x the rest positions,
p those of the frame, l_ij the length of an edge at rest and h the edge of a voxel:

- a leaf card or another small part that hangs on a larger one moves rigidly: by the rotation nearest to its motion,
  and with the point that it hangs on;
- elsewhere the pose y minimises, with d_ij the direction of p_i - p_j,

      Σ_ij w_ij |y_i - y_j - l_ij d_ij|² + Σ_i a_i |y_i - p_i|²,    w_ij = (h / l_ij)²,

  and then `ROUNDS` times the same with the directions of y, in the second half with y for p too (projective dynamics,
  Bouaziz et al. 2014: one factorisation serves all frames), each round going further the way it goes (Chebyshev
  weights, Wang 2015). a_i is small, and large where the tree hardly moves.

A direction turns by less than a right angle however far the motion goes, so the motion saturates.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import no_type_check

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Complex64, Float32, Float64, Int32, Int64

from dynamictree.devoxelize.attachment import CARD_VERTICES, SMALL_PART_VOXELS, Attachments
from dynamictree.devoxelize.length_preserving import (
    LengthPreservingInterpolation,
    OnProgress,
    TreesInterpolation,
    ignore_progress,
)
from dynamictree.devoxelize.symmetric_factor import SymmetricFactor, factored
from dynamictree.mesh import edges_of, weld
from dynamictree.parallel import compiled, in_bands
from dynamictree.spectrum import from_motion, iter_motion

LARGEST_STRETCH = 0.01
"""99th percentile of the edges' stretch in a loop; a motion with less is left as it is."""
ROUNDS = 14
"""At most; fewer for meshes of more than `_SOLVED_ROWS` / 10 vertices, and at least two."""
_SOLVED_ROWS = 150_000
_PLAIN_ROUNDS, _SPECTRAL_RADIUS = 2, 0.98  # see docs/decisions/core.md
_ANCHOR = 0.01  # a of a vertex with the mean motion, see docs/decisions/core.md
_ANCHOR_SHARES = (0.01, 100.0)  # of the motion over its mean
_SHORTEST_EDGE = 0.05  # in voxels; shorter edges are no stiffer
_CLOSE, _SHARE_APART = 0.001, 0.01
"""A pose is good enough where all but this share of its edges have their lengths to this accuracy."""
_FRAMES_AT_ONCE = 10  # two bands of the solver
_SAMPLED_EDGES = 200_000
_SAMPLED_FRAMES = 16
_TURNS = 30  # of the iteration to the nearest rotation


@dataclass(frozen=True, kw_only=True)
class InextensiblePose:
    """Frames of one mesh without stretch; prepared once, applied to any displacement. Built by `inextensible_pose`."""

    vertex: Int32[np.ndarray, " N"]  # vertices at one position are one
    first: Int64[np.ndarray, " n"]
    rest: Float64[np.ndarray, "n 3"]  # [m]
    still: Bool[np.ndarray, " N"]
    attachments: Attachments
    elastic: Int64[np.ndarray, " m"]  # rows of vertices in parts that bend
    edges: Int64[np.ndarray, "E 2"]  # of these
    anchor: Float64[np.ndarray, " m"]
    factor: SymmetricFactor
    pull: scipy.sparse.csr_array  # [m, E], weighted
    rigid: Int64[np.ndarray, " r"]  # rows of vertices in parts that do not

    def apply(self, displacement: Float32[np.ndarray, "N 3"]) -> Float32[np.ndarray, "N 3"]:
        """The pose nearest to this one whose edges keep their lengths [m]."""
        return next(self.iter_poses([displacement]))

    def iter_poses(self, frames: Iterable[Float32[np.ndarray, "N 3"]]) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """The pose nearest to each frame whose edges keep their lengths [m]; several at once, on all cores."""
        for some in _batches(frames, _FRAMES_AT_ONCE):
            moved = [self.rest + frame[self.first].astype(np.float64) for frame in some]
            bent = self._bent([frame[self.elastic] for frame in moved]) if len(self.elastic) else []
            for index, frame in enumerate(moved):
                pose = frame.copy()
                if bent:
                    pose[self.elastic] = bent[index]
                if len(self.rigid):
                    pose[self.rigid] = self._turned(frame[self.rigid])
                shift = (pose - self.rest).astype(np.complex64)[:, None]
                unstretched = np.ascontiguousarray(self.attachments.closed(shift)[:, 0].real[self.vertex])
                unstretched[self.still] = 0
                yield unstretched

    def _bent(self, frames: Sequence[Float64[np.ndarray, "m 3"]]) -> list[Float64[np.ndarray, "m 3"]]:
        rest = self.rest[self.elastic]
        start, end = self.edges.T
        length = np.linalg.norm(rest[start] - rest[end], axis=1)
        poses, directions = list(frames), [frame[start] - frame[end] for frame in frames]
        left, earlier, weight = list(range(len(poses))), list(frames), 1.0
        rounds = 1 + min(ROUNDS, max(2, _SOLVED_ROWS // len(rest)))
        for number in range(rounds):
            weight = _chebyshev_weight(number, weight)
            near = frames if number < rounds // 2 else poses
            right = [self._drawn(near[index], directions[index], length) for index in left]
            solved = self.factor.solve(np.concatenate(right, axis=1))
            for place, index in enumerate(left):
                nearer = earlier[index] + weight * (solved[:, 3 * place : 3 * place + 3] - earlier[index])
                earlier[index], poses[index] = poses[index], nearer
                directions[index] = poses[index][start] - poses[index][end]
            left = [index for index in left if not _fits(directions[index], length)]
            if not left:
                break
        return poses

    def _drawn(
        self,
        pose: Float64[np.ndarray, "m 3"],
        direction: Float64[np.ndarray, "E 3"],
        length: Float64[np.ndarray, " E"],
    ) -> Float64[np.ndarray, "m 3"]:
        """Right-hand side of the system that draws each edge to its length."""
        scale = length / np.maximum(np.sqrt(np.einsum("ec,ec->e", direction, direction)), 1e-12)
        drawn: Float64[np.ndarray, "m 3"] = self.pull @ (direction * scale[:, None]) + self.anchor[:, None] * pose
        return drawn

    def _turned(self, moved: Float64[np.ndarray, "r 3"]) -> Float64[np.ndarray, "r 3"]:
        part, rest = self.attachments.part[self.rigid], self.rest[self.rigid]
        num_parts = int(self.attachments.part.max()) + 1
        count = np.maximum(np.bincount(part, minlength=num_parts), 1)[:, None]
        middle, rest_middle = (_sums(part, points, num_parts) / count for points in (moved, rest))
        offset, rest_offset = moved - middle[part], rest - rest_middle[part]
        products = (offset[:, :, None] * rest_offset[:, None]).reshape(-1, 9)
        turn = nearest_rotations(_sums(part, products, num_parts).reshape(-1, 3, 3))
        turned: Float64[np.ndarray, "r 3"] = middle[part] + np.einsum("nij,nj->ni", turn[part], rest_offset)
        return turned


def _chebyshev_weight(number: int, before: float) -> float:
    """How far round `number` goes from the pose before the last towards its solution; 1 takes the solution."""
    if number < _PLAIN_ROUNDS:
        return 1.0
    return 2 / (2 - _SPECTRAL_RADIUS**2) if number == _PLAIN_ROUNDS else 4 / (4 - _SPECTRAL_RADIUS**2 * before)


def inextensible_pose(
    interpolation: LengthPreservingInterpolation, coefficients: Complex64[np.ndarray, "N K 3"]
) -> InextensiblePose:
    """Prepare for the mesh of an interpolation; `coefficients` are its vertices' [m], and say what hardly moves."""
    attachments = interpolation.interpolation.attachments
    mesh, vertex = weld(interpolation.mesh.moving_part)
    assert attachments is not None
    first = np.unique(vertex, return_index=True)[1]
    voxel_m = interpolation.grid.voxel_size_m
    rest = mesh.vertices.astype(np.float64)
    is_rigid = _cards(attachments, rest, voxel_m)[attachments.part]
    elastic, rigid = np.flatnonzero(~is_rigid), np.flatnonzero(is_rigid)
    row = np.cumsum(~is_rigid) - 1
    edges = edges_of(mesh.faces)
    edges = row[edges[~is_rigid[edges[:, 0]]]]
    length = np.linalg.norm(rest[elastic][edges[:, 0]] - rest[elastic][edges[:, 1]], axis=1)
    edges, length = edges[length > 0], length[length > 0]
    weight = (voxel_m / np.maximum(length, _SHORTEST_EDGE * voxel_m)) ** 2
    power = np.abs(coefficients[first][elastic]) ** 2
    size = np.sqrt(power.sum(axis=(1, 2), dtype=np.float64))
    share = size / max(float(size.mean()) if len(size) else 0.0, 1e-30)
    anchor = _ANCHOR / share.clip(*_ANCHOR_SHARES) ** 2
    number = np.arange(len(edges))
    ends = (np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([number, number]))
    signs = np.repeat([1.0, -1.0], len(edges))
    shape = (len(elastic), len(edges))
    difference = scipy.sparse.csr_array((signs, ends), shape=shape)
    pull = (difference * weight).tocsr()
    system = (pull @ difference.T + scipy.sparse.diags_array(anchor)).tocsc()
    return InextensiblePose(
        vertex=vertex,
        first=first,
        rest=rest,
        still=interpolation.mesh.still_vertices,
        attachments=attachments,
        elastic=elastic,
        edges=edges,
        anchor=anchor,
        factor=factored(system),
        pull=pull,
        rigid=rigid,
    )


@dataclass(frozen=True, kw_only=True)
class TreesPose:
    """Poses of several trees of one mesh; vertices of no tree stand still."""

    num_vertices: int
    trees: tuple[tuple[Int32[np.ndarray, " _"], InextensiblePose], ...]

    def iter_poses(self, frames: Iterable[Float32[np.ndarray, "N 3"]]) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """The pose nearest to each frame whose edges keep their lengths [m]; several at once, on all cores."""
        for some in _batches(frames, _FRAMES_AT_ONCE):
            unstretched = np.zeros((len(some), self.num_vertices, 3), np.float32)
            for vertices, tree in self.trees:
                own = (np.ascontiguousarray(frame[vertices]) for frame in some)
                for index, pose in enumerate(tree.iter_poses(own)):
                    unstretched[index, vertices] = pose
            yield from unstretched


def pose_of(
    interpolation: LengthPreservingInterpolation | TreesInterpolation, coefficients: Complex64[np.ndarray, "N K 3"]
) -> InextensiblePose | TreesPose:
    """`inextensible_pose` of one tree, or of each of several by itself."""
    if isinstance(interpolation, LengthPreservingInterpolation):
        return inextensible_pose(interpolation, coefficients)
    poses = tuple((rows, inextensible_pose(tree, coefficients[rows])) for rows, _, tree in interpolation.trees)
    return TreesPose(num_vertices=interpolation.num_vertices, trees=poses)


def without_stretch(
    pose: InextensiblePose | TreesPose,
    coefficients: Complex64[np.ndarray, "N K 3"],
    num_frames: int,
    on_progress: OnProgress = ignore_progress,
    *,
    num_frequencies: int | None = None,
) -> Complex64[np.ndarray, "N L 3"]:
    """L frequencies, by default K, of a loop whose frames do not stretch; some stretch comes back with those above L.

    `on_progress` gets the share done after each frame; what it raises passes through.
    """
    unstretched = np.empty((num_frames, len(coefficients), 3), np.float32)
    frames = iter_motion(coefficients, np.arange(num_frames) / num_frames, num_frames)
    for index, frame in enumerate(pose.iter_poses(frames)):
        unstretched[index] = frame
        on_progress((index + 1) / num_frames)
    return from_motion(unstretched, num_frequencies or coefficients.shape[1])


def typical_stretch(
    interpolation: LengthPreservingInterpolation | TreesInterpolation, coefficients: Complex64[np.ndarray, "N K 3"]
) -> float:
    """99th percentile of |length / length at rest - 1| over edges and frames of a loop, from a sample of both.

    Of several trees, that of the one with most.
    """
    if isinstance(interpolation, TreesInterpolation):
        return max(typical_stretch(tree, coefficients[vertices]) for vertices, _, tree in interpolation.trees)
    vertices, edges = interpolation.mesh.vertices, edges_of(interpolation.mesh.faces)
    edges = edges[:: -(-len(edges) // _SAMPLED_EDGES)]
    across = vertices[edges[:, 0]] - vertices[edges[:, 1]]
    length = np.linalg.norm(across, axis=1)
    edges, across, length = edges[length > 0], across[length > 0], length[length > 0]
    if len(edges) == 0:
        return 0.0
    difference = coefficients[edges[:, 0]] - coefficients[edges[:, 1]]
    phases = np.arange(_SAMPLED_FRAMES) / _SAMPLED_FRAMES
    frames = iter_motion(difference, phases, 2 * _SAMPLED_FRAMES * coefficients.shape[1])
    return float(np.percentile([np.abs(np.linalg.norm(across + frame, axis=1) / length - 1) for frame in frames], 99))


def nearest_rotations(matrices: Float64[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n 3 3"]:
    """The rotation nearest to each matrix; also of flat and of zero ones. After Müller et al. 2016."""
    rotations = np.empty_like(matrices)
    if len(matrices):
        in_bands(_rotate, len(matrices), np.ascontiguousarray(matrices), rotations)
    return rotations


@compiled
@no_type_check  # numba compiles no checked function
def _rotate(
    first: int, end: int, matrices: Float64[np.ndarray, "n 3 3"], rotations: Float64[np.ndarray, "n 3 3"]
) -> None:
    """Write the nearest rotations of some rows: turn by the mean moment of the columns until there is none."""
    for row in range(first, end):
        a = matrices[row]
        w, x, y, z = 1.0, 0.0, 0.0, 0.0
        r = rotations[row]
        for _ in range(_TURNS):
            r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
            r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
            r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
            across_x = across_y = across_z = along = 0.0
            for k in range(3):
                across_x += r[1, k] * a[2, k] - r[2, k] * a[1, k]
                across_y += r[2, k] * a[0, k] - r[0, k] * a[2, k]
                across_z += r[0, k] * a[1, k] - r[1, k] * a[0, k]
                along += r[0, k] * a[0, k] + r[1, k] * a[1, k] + r[2, k] * a[2, k]
            scale = 1 / (abs(along) + 1e-30)
            across_x, across_y, across_z = across_x * scale, across_y * scale, across_z * scale
            angle = np.sqrt(across_x * across_x + across_y * across_y + across_z * across_z)
            if angle < 1e-7:
                break
            sine = np.sin(angle / 2) / angle
            c, i, j, k = np.cos(angle / 2), across_x * sine, across_y * sine, across_z * sine
            w, x, y, z = (
                c * w - i * x - j * y - k * z,
                c * x + i * w + j * z - k * y,
                c * y - i * z + j * w + k * x,
                c * z + i * y - j * x + k * w,
            )
            size = 1 / np.sqrt(w * w + x * x + y * y + z * z)
            w, x, y, z = w * size, x * size, y * size, z * size


def _cards(attachments: Attachments, rest: Float64[np.ndarray, "n 3"], voxel_m: float) -> Bool[np.ndarray, " parts"]:
    """Attached parts that are small or have few vertices."""
    part = attachments.part
    num_parts = int(part.max()) + 1
    low, high = np.full((num_parts, 3), np.inf), np.full((num_parts, 3), -np.inf)
    np.minimum.at(low, part, rest)
    np.maximum.at(high, part, rest)
    small = (high - low).max(axis=1) < SMALL_PART_VOXELS * voxel_m
    hangs = np.zeros(num_parts, bool)
    hangs[attachments.children] = True
    return np.asarray(hangs & (small | (np.bincount(part, minlength=num_parts) <= CARD_VERTICES)))


def _batches(frames: Iterable[Float32[np.ndarray, "N 3"]], size: int) -> Iterator[list[Float32[np.ndarray, "N 3"]]]:
    """Lists of up to `size` frames, as they come."""
    source = iter(frames)
    while some := list(islice(source, size)):
        yield some


def _fits(direction: Float64[np.ndarray, "E 3"], length: Float64[np.ndarray, " E"]) -> bool:
    change = np.abs(np.sqrt(np.einsum("ec,ec->e", direction, direction)) - length)
    return bool(np.count_nonzero(change > _CLOSE * length) < _SHARE_APART * len(length))


def _sums(
    part: Int32[np.ndarray, " r"], values: Float64[np.ndarray, "r C"], num_parts: int
) -> Float64[np.ndarray, "P C"]:
    return np.stack([np.bincount(part, column, num_parts) for column in values.T], axis=1)
