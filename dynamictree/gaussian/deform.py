"""Deform a bound cloud with its mesh on the CPU; the paper's step of 2.57 ms per frame on a GPU.

A face's deformation gradient F has a polar decomposition F = R S. A Gaussian rotates by R; its scales become |F e_i|
along its own axes e_i; its mean retains its weights in the face, and its offset rotates by R. Along the normal F is 1.

`Deformer` arranges all data at rest once, in blocks for vector units.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64, Int32

from dynamictree.errors import InputError
from dynamictree.gaussian.binding import STILL, Binding
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.deform_kernel import BLOCK, turn_faces, turn_gaussians
from dynamictree.gaussian.turn import turn_sh_fast
from dynamictree.gaussian.vector_rows import CACHE_LINE_BYTES, LANES
from dynamictree.parallel import in_bands
from dynamictree.rotation import matrix_quaternions, quaternion_matrices, quaternion_products


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Geometry of a cloud's Gaussians at one moment; opacity and colours, in the Gaussians' frames, stay the same."""

    means: Float32[np.ndarray, "G 3"]  # [m]
    quaternions: Float32[np.ndarray, "G 4"]  # wxyz
    scales: Float32[np.ndarray, "G 3"]  # [m]

    @classmethod
    def empty(cls, num_gaussians: int) -> "Pose":
        """Allocate a pose aligned to cache lines, to which `Deformer.pose` writes fastest."""
        means, quaternions, scales = (_at_cache_line((num_gaussians, width)) for width in (3, 4, 3))
        return cls(means=means, quaternions=quaternions, scales=scales)


class Deformer:
    """Computation of poses of a bound cloud, prepared once per binding."""

    def __init__(self, binding: Binding) -> None:
        self.binding = binding
        num_faces = len(binding.triangles)
        frames, flat = rest_frames(binding)
        edges = np.diff(binding.vertices[binding.triangles].astype(np.float64), axis=1)  # edges 01 and 12 [U, 2, 3]
        face_rest = np.concatenate(
            [
                edges[:, 0],
                edges[:, 0] + edges[:, 1],
                matrix_quaternions(frames),
                1 / flat[:, :1],
                flat[:, 1:2],
                1 / flat[:, 2:],
            ],
            axis=1,
        )  # [U, 13]
        self._face_rest = _in_blocks(face_rest)
        self._triangles = _padded(binding.triangles)
        still = len(self._triangles)
        self._faces = _at_cache_line((still + 1, LANES))  # current state; the last face is at rest, for still Gaussians
        self._faces[:] = 0
        self._faces[still, 9] = 1  # w of the identity
        face_of = np.where(binding.face_of == STILL, num_faces, binding.face_of).astype(np.int32)
        self._rest = _in_blocks(self._gaussian_rest(frames, face_of))
        self._face_of = _padded(np.where(binding.face_of == STILL, np.int32(still), face_of))

    def pose(
        self,
        displacement: Float32[np.ndarray, "N 3"],
        leaf_turns: Float32[np.ndarray, "M 3"] | None = None,
        *,
        out: Pose | None = None,
    ) -> Pose:
        """Compute the Gaussians' pose for a displacement of the mesh's vertices.

        Args:
            displacement: displacement of every vertex from rest [m].
            leaf_turns: rotation θ of each leaf [rad]; by default leaves do not flutter.
            out: contiguous memory to write to, which is also returned; newly allocated by default.

        Raises:
            InputError: the displacement has another shape than the mesh's vertices.
        """
        if displacement.shape != self.binding.vertices.shape:
            raise InputError(
                f"the displacement is of {len(displacement)} vertices; the mesh has {len(self.binding.vertices)}"
            )
        moved = np.ascontiguousarray(displacement)
        in_bands(turn_faces, len(self._face_rest), self._face_rest, self._triangles, moved, self._faces)
        posed = Pose.empty(self.binding.cloud.num_gaussians) if out is None else out
        parts = posed.means, posed.quaternions, posed.scales
        assert all(part.flags.c_contiguous for part in parts)
        flat = [part.reshape(-1) for part in parts]
        streamed = all(part.ctypes.data % CACHE_LINE_BYTES == 0 for part in flat)
        in_bands(turn_gaussians, len(self._rest), self._rest, self._face_of, self._faces, *flat, streamed)
        if leaf_turns is not None and (leaves := self.binding.leaves) is not None:
            rows = np.flatnonzero(leaves.of != STILL)
            leaf, foot = leaves.of[rows], (self.binding.vertices + moved)[leaves.vertex]
            cosine = 1 / np.sqrt(1 + (leaf_turns**2).sum(axis=1, keepdims=True))  # an angle of atan |θ|
            turns = np.concatenate([np.sqrt((1 + cosine) / 2), leaf_turns * cosine / np.sqrt(2 + 2 * cosine)], axis=1)
            arms = posed.means[rows] - foot[leaf]
            posed.means[rows] = foot[leaf] + np.einsum("gij,gj->gi", quaternion_matrices(turns)[leaf], arms)
            posed.quaternions[rows] = quaternion_products(turns[leaf], posed.quaternions[rows])
        return posed

    def _gaussian_rest(
        self, frames: Float64[np.ndarray, "U 3 3"], face_of: Int32[np.ndarray, " G"]
    ) -> Float64[np.ndarray, "G 15"]:
        """Columns: weights 1, 2, offset in the face's axes, point on the face, rotation from these axes, scales."""
        binding, cloud = self.binding, self.binding.cloud
        all_frames = np.concatenate([frames, np.eye(3)[None]])[face_of]  # [G, 3, 3]
        means = cloud.means.astype(np.float64)
        offsets = np.where(binding.moving[:, None], means - _bound_points(binding), 0)
        frame_turn = matrix_quaternions(all_frames) * np.array([1, -1, -1, -1])  # inverse
        return np.concatenate(
            [
                binding.weights[:, 1:],
                np.einsum("gji,gj->gi", all_frames, offsets),
                means - offsets,
                quaternion_products(frame_turn, cloud.quaternions.astype(np.float64)),
                cloud.scales,
            ],
            axis=1,
        )


def apply_pose(cloud: GaussianCloud, pose: Pose) -> GaussianCloud:
    """Apply a pose to a cloud, with colours rotated like their Gaussians, for export to a file."""
    turns = quaternion_products(pose.quaternions, cloud.quaternions * np.array([1, -1, -1, -1], np.float32))
    return replace(
        cloud, means=pose.means, quaternions=pose.quaternions, scales=pose.scales, sh=turn_sh_fast(cloud.sh, turns)
    )


def rest_frames(binding: Binding) -> tuple[Float64[np.ndarray, "U 3 3"], Float64[np.ndarray, "U 3"]]:
    """Return each face's axes at rest as columns (along edge 01, across, normal), and the face in these axes.

    The corners in the face's plane are (0, 0), (L, 0) and (X, Y); the result has L, X, Y [m].
    """
    corners = binding.vertices[binding.triangles].astype(np.float64)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1, keepdims=True)
    along = first / length
    normal = np.cross(first, second)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross(normal, along)
    flat = np.stack([length[:, 0], (second * along).sum(axis=1), (second * across).sum(axis=1)], axis=1)
    return np.stack([along, across, normal], axis=2), flat


def _bound_points(binding: Binding) -> Float64[np.ndarray, "G 3"]:
    """Return the surface point to which each Gaussian is bound [m]."""
    if len(binding.triangles) == 0:
        return binding.cloud.means.astype(np.float64)
    corners = binding.vertices.astype(np.float64)[binding.triangles[binding.face_of]]  # [G, 3, 3]
    places: Float64[np.ndarray, "G 3"] = np.einsum("gc,gcx->gx", binding.weights.astype(np.float64), corners)
    return places


def _in_blocks(rows: Float64[np.ndarray, "M W"]) -> Float32[np.ndarray, "blocks WB"]:
    """Arrange rows in blocks, column by column within a block; the last block is padded with its last row."""
    num_blocks = -(-len(rows) // BLOCK)
    padded = np.pad(rows.astype(np.float32), ((0, num_blocks * BLOCK - len(rows)), (0, 0)), mode="edge")
    return np.ascontiguousarray(padded.reshape(num_blocks, BLOCK, -1).transpose(0, 2, 1)).reshape(num_blocks, -1)


def _padded(rows: Int32[np.ndarray, "..."]) -> Int32[np.ndarray, "..."]:
    """Pad rows to whole blocks with the last row."""
    missing = -len(rows) % BLOCK
    return np.pad(rows, [(0, missing)] + [(0, 0)] * (rows.ndim - 1), mode="edge")


def _at_cache_line(shape: tuple[int, int]) -> Float32[np.ndarray, "rows width"]:
    """Allocate memory that is aligned to a cache line."""
    num_bytes = 4 * shape[0] * shape[1]
    raw = np.empty(num_bytes + CACHE_LINE_BYTES, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE_BYTES
    return raw[start : start + num_bytes].view(np.float32).reshape(shape)
