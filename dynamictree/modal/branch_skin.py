"""A skin whose joints lie in the branches, with the rigid motions nearest to a loop. For engines that simulate joints.

Bones and the vertices that they carry come from the spectrum (`bones.py`, `bone_attachment.py`). What is left are each
bone's rotations and translations, frame by frame: Kabsch's fit to the vertices' own motion, one bone after the other,
each against what the others leave. Stiffer than the motion: leaves that flutter within a bone are lost; a skin that
only plays the motion is nearer to it with the joints of `fitted_skin.py`.
"""

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.devoxelize.smooth import smooth
from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.bone_attachment import attach_mesh
from dynamictree.modal.bones import bones_of
from dynamictree.modal.system import modal_system
from dynamictree.skin import JOINTS_PER_VERTEX, Skin, SkinSummary
from dynamictree.spectrum import SparseVoxelSpectrum, iter_motion

JOINT_VOXELS = 10.0  # from one joint to the next: twice as far as in a pull, because engines pay for each
ROUNDS = 2  # a third gains less than a hundredth of the error
FITTED_VERTICES = 40_000  # of a larger mesh, evenly chosen; all count in the reported error
_UPRIGHT = 1e-6  # [m²] of a vertex: bones with too few points to fix a rotation do not turn


def branch_skin(
    spectrum: SparseVoxelSpectrum, mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"]
) -> tuple[Skin, SkinSummary]:
    """Find a skeleton and fit its bones to one period of the vertices' motion.

    Raises:
        InputError: the spectrum tells of no branches.
    """
    bones = bones_of(modal_system(spectrum), length_voxels=JOINT_VOXELS, one_root=True)
    if len(bones.parent) < 2:
        raise InputError("no skeleton was found: the tree moves as one piece; ask for glb instead of glb-skinned")
    ties = smooth(spectrum.grid, mesh)
    tied = attach_mesh(bones, mesh, ties, voxel_size_m=spectrum.grid.voxel_size_m, parts_hang=False)
    weights = tied.weights[:, :JOINTS_PER_VERTEX]  # the strongest come first
    total = weights.sum(axis=1, keepdims=True)
    weights = weights / np.where(total > 0, total, 1)
    rows = tied.rows[:, :JOINTS_PER_VERTEX]
    rotation, translation = _fitted(bones.parent, rows, weights, mesh.vertices, coefficients, spectrum.num_frames)
    parent, joint_m = bones.parent, bones.joint_m
    still = total[:, 0] == 0
    if still.any():  # a root that never moves carries them
        rows, weights = rows.copy(), weights.copy()
        rows[still], weights[still, 0] = len(parent), 1
        parent = np.append(parent, np.int32(-1))
        joint_m = np.concatenate([joint_m, mesh.vertices[still].mean(axis=0, keepdims=True)])
        rotation = np.concatenate([rotation, np.broadcast_to(np.eye(3), (len(rotation), 1, 3, 3))], axis=1)
        translation = np.concatenate([translation, np.zeros_like(translation[:, :1])], axis=1)
    skin = Skin(
        parent=parent,
        joint_m=joint_m,
        rows=rows,
        weights=weights,
        rotation=rotation.astype(np.float32),
        translation_m=translation.astype(np.float32),
    )
    return skin, summary_of(skin, mesh.vertices, coefficients, spectrum.num_frames)


def _fitted(
    parent: np.ndarray,
    rows: np.ndarray,
    weights: np.ndarray,
    vertices: Float32[np.ndarray, "N 3"],
    coefficients: Complex64[np.ndarray, "N K 3"],
    num_frames: int,
) -> tuple[Float64[np.ndarray, "T B 3 3"], Float64[np.ndarray, "T B 3"]]:
    chosen = np.arange(0, len(vertices), -(-len(vertices) // FITTED_VERTICES))
    points, rows, weights = vertices[chosen].astype(np.float64), rows[chosen], weights[chosen].astype(np.float64)
    phases = np.arange(num_frames) / num_frames
    left = points + np.stack(list(iter_motion(coefficients[chosen], phases, num_frames)))  # [T, N, 3], still to explain
    rotation = np.broadcast_to(np.eye(3), (num_frames, len(parent), 3, 3)).copy()
    translation = np.zeros((num_frames, len(parent), 3))
    members = [np.nonzero((rows == bone) & (weights > 0)) for bone in range(len(parent))]
    target = left.copy()
    for bone, (at, slot) in enumerate(members):  # first as if each were alone
        if len(at):
            rotation[:, bone], translation[:, bone] = nearest_rigid_motion(points[at], target[:, at], weights[at, slot])
        elif parent[bone] >= 0:
            rotation[:, bone], translation[:, bone] = rotation[:, parent[bone]], translation[:, parent[bone]]
        left[:, at] -= weights[at, slot][:, None] * carried(points[at], rotation[:, bone], translation[:, bone])
    for _ in range(ROUNDS):
        for bone, (at, slot) in enumerate(members):
            if not len(at):
                continue
            w = weights[at, slot]
            own = left[:, at] + w[:, None] * carried(points[at], rotation[:, bone], translation[:, bone])
            rotation[:, bone], translation[:, bone] = nearest_rigid_motion(points[at], own / w[:, None], w**2)
            left[:, at] = own - w[:, None] * carried(points[at], rotation[:, bone], translation[:, bone])
    return rotation, translation


def nearest_rigid_motion(
    points: Float64[np.ndarray, "n 3"], targets: Float64[np.ndarray, "T n 3"], weights: Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "T 3 3"], Float64[np.ndarray, "T 3"]]:
    """The rigid motion of each frame with the least Σ w |R p + t - q|². Kabsch 1976."""
    share = weights / weights.sum()
    middle, aims = share @ points, share @ targets  # [3], [T, 3]
    cross = np.swapaxes(targets - aims[:, None], 1, 2) @ (share[:, None] * (points - middle))  # Σ w q pᵀ, [T, 3, 3]
    u, _, vt = np.linalg.svd(cross + _UPRIGHT * np.eye(3))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation = u @ vt
    return rotation, aims - rotation @ middle


def carried(
    points: Float64[np.ndarray, "n 3"],
    rotation: Float64[np.ndarray, "T 3 3"],
    translation: Float64[np.ndarray, "T 3"],
) -> Float64[np.ndarray, "T n 3"]:
    """Where one joint carries points, frame by frame."""
    return np.asarray(points @ np.swapaxes(rotation, 1, 2) + translation[:, None])


def summary_of(
    skin: Skin, vertices: Float32[np.ndarray, "N 3"], coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int
) -> SkinSummary:
    """How far a skin is from one period of the motion."""
    total = missing = largest = 0.0
    for frame, moved in enumerate(iter_motion(coefficients, np.arange(num_frames) / num_frames, num_frames)):
        gap = ((skin.displacement(vertices, frame) - moved) ** 2).sum(axis=1)
        total, missing = total + float((moved**2).sum()), missing + float(gap.sum())
        largest = max(largest, float(gap.max()))
    return SkinSummary(
        num_joints=len(skin.parent),
        num_keys=num_frames + 1,
        relative_error=float(np.sqrt(missing / total)) if total > 0 else 0.0,
        rms_error_m=float(np.sqrt(missing / (num_frames * len(vertices)))),
        max_error_m=float(np.sqrt(largest)),
    )
