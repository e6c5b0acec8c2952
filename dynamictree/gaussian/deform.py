"""Move a bound cloud with its mesh: the paper's 2.57 ms a frame on a GPU, here both cores of a CPU.

A face's deformation gradient F has a polar decomposition F = R S. A Gaussian turns by R, its scales become |F e_i|
along its own axes e_i, its mean keeps its weights in the face and its offset turns by R. Along the normal F is 1.

`Deformer` is the fast form: everything that rests is laid out once, in blocks that vector units read. `deform_slowly`
is the readable one, which the tests compare it with.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from dynamictree.errors import InputError
from dynamictree.gaussian.binding import STILL, Binding
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.deform_kernel import BLOCK, COLLAPSED, MAX_STRETCH, turn_faces, turn_gaussians
from dynamictree.gaussian.turn import turn_sh_fast
from dynamictree.gaussian.vector_rows import CACHE_LINE_BYTES, LANES
from dynamictree.parallel import in_bands
from dynamictree.rotation import (
    matrix_quaternions,
    polar_rotations,
    quaternion_matrices,
    quaternion_products,
)


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Where a cloud's Gaussians are at one moment; opacity and colours are the cloud's, as each sees them."""

    means: Float32[np.ndarray, "G 3"]  # [m]
    quaternions: Float32[np.ndarray, "G 4"]  # wxyz
    scales: Float32[np.ndarray, "G 3"]  # [m]

    @classmethod
    def empty(cls, num_gaussians: int) -> "Pose":
        """Memory for a pose, which `Deformer.pose` writes fastest to."""
        means, quaternions, scales = (_at_cache_line((num_gaussians, width)) for width in (3, 4, 3))
        return cls(means=means, quaternions=quaternions, scales=scales)


class Deformer:
    """Computes poses of a bound cloud; prepared once per binding."""

    def __init__(self, binding: Binding) -> None:
        self.binding = binding
        num_faces = len(binding.triangles)
        frames, flat = rest_frames(binding)
        edges = np.diff(binding.vertices[binding.triangles].astype(np.float64), axis=1)  # 01 and 12 [U, 2, 3]
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
        self._face_rest = _blocked(face_rest)
        self._triangles = _filled(binding.triangles)
        still = len(self._triangles)
        self._faces = _at_cache_line((still + 1, LANES))  # as they are now; the last one rests, for the still
        self._faces[:] = 0
        self._faces[still, 9] = 1  # w of no rotation
        face_of = np.where(binding.face_of == STILL, num_faces, binding.face_of).astype(np.int32)
        self._rest = _blocked(self._gaussian_rest(frames, face_of))
        self._face_of = _filled(np.where(binding.face_of == STILL, np.int32(still), face_of))

    def pose(self, displacement: Float32[np.ndarray, "N 3"], *, out: Pose | None = None) -> Pose:
        """Where the Gaussians are when the mesh's vertices are displaced.

        Args:
            displacement: of every vertex from its rest [m].
            out: memory to write to, contiguous, which is also the result; fresh by default.

        Raises:
            InputError: the displacement is not that of the mesh's vertices.
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
        return posed

    def _gaussian_rest(
        self, frames: Float64[np.ndarray, "U 3 3"], face_of: Int32[np.ndarray, " G"]
    ) -> Float64[np.ndarray, "G 15"]:
        """Weights 1 and 2, offset along the face's axes, place on the face, rotation from the face's axes, scales."""
        binding, cloud = self.binding, self.binding.cloud
        all_frames = np.concatenate([frames, np.eye(3)[None]])[face_of]  # [G, 3, 3]
        means = cloud.means.astype(np.float64)
        offsets = np.where(binding.moving[:, None], means - _places(binding), 0)
        frame_turn = matrix_quaternions(all_frames) * np.array([1, -1, -1, -1])  # undone
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


def deform_slowly(binding: Binding, displacement: Float32[np.ndarray, "N 3"]) -> Pose:
    """The readable twin of `Deformer.pose`, in numpy and double precision."""
    cloud, moving = binding.cloud, binding.moving
    gradients, rotations = (per_face[binding.face_of[moving]] for per_face in face_gradients(binding, displacement))
    corners = (binding.vertices + displacement).astype(np.float64)[binding.triangles]  # [U, 3, 3]
    offsets = (cloud.means.astype(np.float64) - _places(binding))[moving]
    axes = quaternion_matrices(cloud.quaternions[moving].astype(np.float64))  # columns e_i [M, 3, 3]
    stretch = np.linalg.norm(gradients @ axes, axis=1)  # |F e_i| [M, 3]
    means, quaternions, scales = cloud.means.copy(), cloud.quaternions.copy(), cloud.scales.copy()
    places = np.einsum("mc,mcx->mx", binding.weights[moving], corners[binding.face_of[moving]])
    means[moving] = places + np.einsum("mxy,my->mx", rotations, offsets)
    quaternions[moving] = quaternion_products(
        matrix_quaternions(rotations), cloud.quaternions[moving].astype(np.float64)
    )
    scales[moving] *= np.clip(stretch, 1 / MAX_STRETCH, MAX_STRETCH)
    return Pose(means=means, quaternions=quaternions, scales=scales)


def posed(cloud: GaussianCloud, pose: Pose) -> GaussianCloud:
    """The cloud as it is in a pose, colours turned with their Gaussians: what is written to a file."""
    turns = quaternion_products(pose.quaternions, cloud.quaternions * np.array([1, -1, -1, -1], np.float32))
    return replace(
        cloud,
        means=pose.means,
        quaternions=pose.quaternions,
        scales=pose.scales,
        sh=turn_sh_fast(cloud.sh, turns),
    )


def shape_error(binding: Binding, displacement: Float32[np.ndarray, "N 3"]) -> Float64[np.ndarray, " M"]:
    """How far each moving Gaussian's shape is from F Σ Fᵀ, which need not have its axes where R takes them.

    Relative, in the Frobenius norm. What GaMeS and we give up so that a Gaussian stays a rotation and three scales.
    """
    moving = binding.moving
    gradients, _ = face_gradients(binding, displacement)
    gradients = gradients[binding.face_of[moving]]
    pose = deform_slowly(binding, displacement)
    before = _covariances(binding.cloud.quaternions[moving], binding.cloud.scales[moving])
    after = _covariances(pose.quaternions[moving], pose.scales[moving])
    exact = gradients @ before @ gradients.transpose(0, 2, 1)
    error: Float64[np.ndarray, " M"] = np.linalg.norm(after - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    return error


def face_gradients(
    binding: Binding, displacement: Float32[np.ndarray, "N 3"]
) -> tuple[Float64[np.ndarray, "U 3 3"], Float64[np.ndarray, "U 3 3"]]:
    """F of every face, and R of its polar decomposition. A face that collapsed turns as its longer edge does."""
    before = binding.vertices.astype(np.float64)[binding.triangles]  # [U, 3, 3]
    after = before + displacement.astype(np.float64)[binding.triangles]
    at_rest, _ = _with_normal(before)
    moved, collapsed = _with_normal(after)  # columns: edges 01 and 02, normal
    rest_inverse = np.linalg.inv(at_rest)
    rotations = polar_rotations(moved @ rest_inverse)
    for face in np.flatnonzero(collapsed):
        rotations[face] = _shortest_arc(at_rest[face, :, :2].T, moved[face, :, :2].T)
        moved[face, :, 2] = rotations[face] @ at_rest[face, :, 2]
    return moved @ rest_inverse, rotations


def rest_frames(binding: Binding) -> tuple[Float64[np.ndarray, "U 3 3"], Float64[np.ndarray, "U 3"]]:
    """Axes of each face at rest as columns (along edge 01, across, normal), and the face in them.

    The corners in the face's plane are (0, 0), (L, 0) and (X, Y); given are L, X, Y [m].
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


def _with_normal(
    corners: Float64[np.ndarray, "U 3 3"],
) -> tuple[Float64[np.ndarray, "U 3 3"], Bool[np.ndarray, " U"]]:
    """Two edges and the unit normal as columns, and whether the face has collapsed to a line or a point."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    area = np.linalg.norm(normal, axis=1)
    collapsed = area <= COLLAPSED * ((first * first).sum(axis=1) + (second * second).sum(axis=1))
    normal /= np.maximum(area, np.finfo(np.float64).tiny)[:, None]
    return np.stack([first, second, normal], axis=2), collapsed


def _shortest_arc(before: Float64[np.ndarray, "2 3"], after: Float64[np.ndarray, "2 3"]) -> Float64[np.ndarray, "3 3"]:
    """The least rotation that takes the longer edge where it points now; none where it has no length either."""
    longer = int(np.argmax((after * after).sum(axis=1)))
    length = np.linalg.norm(after[longer])
    if length == 0:
        return np.eye(3)
    a, b = before[longer] / np.linalg.norm(before[longer]), after[longer] / length
    quaternion = np.concatenate([[1 + a @ b], np.cross(a, b)])
    norm = np.linalg.norm(quaternion)
    if norm < COLLAPSED:
        return np.eye(3)
    result: Float64[np.ndarray, "3 3"] = quaternion_matrices(quaternion[None] / norm)[0]
    return result


def _places(binding: Binding) -> Float64[np.ndarray, "G 3"]:
    """Where each Gaussian's mean would be without its offset [m]."""
    if len(binding.triangles) == 0:
        return binding.cloud.means.astype(np.float64)
    corners = binding.vertices.astype(np.float64)[binding.triangles[binding.face_of]]  # [G, 3, 3]
    places: Float64[np.ndarray, "G 3"] = np.einsum("gc,gcx->gx", binding.weights.astype(np.float64), corners)
    return places


def _covariances(
    quaternions: Float32[np.ndarray, "M 4"], scales: Float32[np.ndarray, "M 3"]
) -> Float64[np.ndarray, "M 3 3"]:
    rotations = quaternion_matrices(quaternions.astype(np.float64))
    axes = rotations * scales[:, None, :]  # columns s_i e_i
    result: Float64[np.ndarray, "M 3 3"] = axes @ axes.transpose(0, 2, 1)
    return result


def _blocked(rows: Float64[np.ndarray, "M W"]) -> Float32[np.ndarray, "blocks WB"]:
    """Rows in blocks: in each, all first columns, then all second ones, and so on; the last is filled with its end."""
    num_blocks = -(-len(rows) // BLOCK)
    padded = np.pad(rows.astype(np.float32), ((0, num_blocks * BLOCK - len(rows)), (0, 0)), mode="edge")
    return np.ascontiguousarray(padded.reshape(num_blocks, BLOCK, -1).transpose(0, 2, 1)).reshape(num_blocks, -1)


def _filled(rows: Int32[np.ndarray, "..."]) -> Int32[np.ndarray, "..."]:
    """Rows filled up to whole blocks with the last one."""
    missing = -len(rows) % BLOCK
    return np.pad(rows, [(0, missing)] + [(0, 0)] * (rows.ndim - 1), mode="edge")


def _at_cache_line(shape: tuple[int, int]) -> Float32[np.ndarray, "rows width"]:
    """Memory that begins at a cache line."""
    num_bytes = 4 * shape[0] * shape[1]
    raw = np.empty(num_bytes + CACHE_LINE_BYTES, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE_BYTES
    return raw[start : start + num_bytes].view(np.float32).reshape(shape)
