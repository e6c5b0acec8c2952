"""Joints that a pull bends: points of the rig beyond which all parts can rotate without tearing the surface.

A bone attached at one point that carries nothing, such as a card, has the joint of its carrier. Bones of equal depth
connected by edges of the mesh, and their carriers, as in a wide trunk or a crown that is one surface, share a joint. A
bend κ_j rotates everything beyond joint j, in the shape x' of the tree under wind and forces:

    A_j = A_i exp[κ_j]×,      p_j = p_i + A_i (j_j - j_i),      x'' = Σ_b w_b (p_j(b) + A_j(b) (x'_b - j_j(b)))

with i the joint that carries j, j_j its position at rest, and x'_b the point's position if bone b alone carries it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import no_type_check

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Float64, Int32, Int64
from scipy.sparse.csgraph import connected_components

from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.modal.bones import Bones
from dynamictree.modal.system import ModalSystem
from dynamictree.parallel import compiled
from dynamictree.rig.pose import Poses, Skeleton


@dataclass(frozen=True, kw_only=True)
class Joints:
    """J joints, each after its carrier; the first is the ground, which never bends."""

    parent: Int32[np.ndarray, " J"]  # -1 for the ground
    place_m: Float64[np.ndarray, "J 3"]
    of_bone: Int32[np.ndarray, " B"]
    of_voxel: Int32[np.ndarray, " V"]
    num_carried: Int64[np.ndarray, " J"]  # number of voxels beyond
    moved: Float64[np.ndarray, "J M"]  # e_k of the voxels beyond
    strain: Float64[np.ndarray, " J"]  # strain of the edges across the joint, per radian of bend

    def chain(self, voxel: int) -> Int64[np.ndarray, " n"]:
        """Return the joint of a voxel and those that carry it, which bend under a pull there."""
        rows, joint = [], int(self.of_voxel[voxel])
        while joint > 0:
            rows.append(joint)
            joint = int(self.parent[joint])
        return np.array(rows, np.int64)

    def omega(self, system: ModalSystem, chain: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Compute the modes' mean frequency beyond each joint of a chain [rad/s], see `local_bend.py`."""
        share = self.moved[chain] + np.finfo(np.float64).tiny
        return np.asarray(np.sqrt(share @ system.omega**2 / share.sum(axis=1)))

    @cached_property
    def compliance(self) -> Float64[np.ndarray, " J"]:
        """Bend of each joint per moment and per metre to the next, see `pull.py`."""
        tube, most, power = 0.6, 3, 8  # strains of branches are below `tube`, those in one-surface crowns above
        heaviest, by_weight = np.zeros_like(self.parent), np.argsort(self.num_carried, kind="stable")
        heaviest[self.parent[by_weight]] = by_weight  # the last assignment is the heaviest child
        stiffness, forked = np.maximum(self.num_carried, 1.0) ** 2, np.ones(len(self.parent))
        for joint, parent in enumerate(self.parent[1:].tolist(), start=1):
            is_side = parent > 0 and heaviest[parent] != joint
            forked[joint] = forked[parent] * ((stiffness[joint] / stiffness[parent]) ** 0.5 if is_side else 1)
        stiffness *= forked * np.clip(self.strain / tube, 1, most) ** power
        return np.where(np.arange(len(stiffness)) > 0, 1 / stiffness, 0.0)

    def bent(self, stance: Poses, bends: Float64[np.ndarray, "J 3"]) -> Poses:
        """Apply bends to the bones' poses at one moment."""
        frame, place = _frames(np.maximum(self.parent, 0), self.place_m, bends)
        own, joint = frame[self.of_bone], self.of_bone
        arm = stance.place_m[0] - self.place_m[joint]
        return Poses(
            rotation=(own @ stance.rotation[0])[None], place_m=(place[joint] + np.einsum("bij,bj->bi", own, arm))[None]
        )


def joints_of(bones: Bones, mesh: TriangleMesh, shapes: Complex64[np.ndarray, "V M 3"]) -> Joints:
    """Find the joints of a mesh's bones; `shapes` are those of the voxels."""
    skeleton, edges = bones.skeleton, edges_of(mesh.faces)
    ends = bones.of_vertex[edges]
    of_bone = _joint_of_bones(skeleton, bones.stem, np.unique(np.sort(bones.stem[ends]), axis=0))
    parent_bone = np.where(skeleton.parent < 0, -1, of_bone[skeleton.above])
    outermost = parent_bone != of_bone  # bones whose parent has another joint
    size = 1.0 + bones.num_carried
    count = int(of_bone.max()) + 1
    parent = np.full(count, -1, np.int32)
    parent[of_bone[outermost]] = parent_bone[outermost]
    total = np.bincount(of_bone[outermost], size[outermost], count)
    feet = [np.bincount(of_bone[outermost], (size * column)[outermost], count) for column in skeleton.foot_m.T]
    of_voxel, place = of_bone[bones.of_voxel].astype(np.int32), np.stack(feet, axis=1) / total[:, None]
    return Joints(
        parent=parent,
        place_m=place,
        of_bone=of_bone,
        of_voxel=of_voxel,
        num_carried=_sum_beyond(parent, np.bincount(of_voxel, minlength=count)),
        moved=_motion_beyond(parent, of_voxel, shapes),
        strain=_strain(parent, place, of_bone[ends], mesh.vertices[edges].astype(np.float64)),
    )


def _sum_beyond(parent: Int32[np.ndarray, " J"], own: np.ndarray) -> np.ndarray:
    """Sum values over each joint and all joints that it carries."""
    total = own.copy()
    for joint in range(len(parent) - 1, 0, -1):
        total[parent[joint]] += total[joint]
    return total


def _motion_beyond(
    parent: Int32[np.ndarray, " J"], of_voxel: Int32[np.ndarray, " V"], shapes: Complex64[np.ndarray, "V M 3"]
) -> Float64[np.ndarray, "J M"]:
    """Compute each mode's squared motion of the voxels beyond a joint, relative to the joint [m²]."""
    absolute = 0.01  # share of the absolute motion that is added, since a tip has little beyond it
    count, of_joint = np.bincount(of_voxel, minlength=len(parent)), (of_voxel, np.arange(len(of_voxel)))
    member = scipy.sparse.csr_array((np.ones(len(of_voxel)), of_joint), shape=(len(parent), len(of_voxel)))
    total = (member @ shapes.reshape(len(shapes), -1)).reshape(len(parent), *shapes.shape[1:])
    mean = total / np.maximum(count, 1)[:, None, None]
    for joint in range(1, len(parent)):
        if count[joint] == 0:
            mean[joint] = mean[parent[joint]]
    square = _sum_beyond(parent, member @ (np.abs(shapes) ** 2).sum(axis=2))
    cross = (mean.conj() * _sum_beyond(parent, total)).real.sum(axis=2)
    apart = square - 2 * cross + _sum_beyond(parent, count)[:, None] * (np.abs(mean) ** 2).sum(axis=2)
    return np.asarray(np.maximum(apart, 0) + absolute * square)


def _joint_of_bones(
    skeleton: Skeleton, stem: Int32[np.ndarray, " B"], joined: Int32[np.ndarray, "P 2"]
) -> Int32[np.ndarray, " B"]:
    """Return each bone's joint, numbered by depth; `joined` are pairs of bones connected by edges."""
    above, depth = skeleton.above, skeleton.depths
    one, other = joined.T
    pairs = [np.stack([np.arange(len(stem)), stem])]
    while len(one):
        deeper = depth[one] >= depth[other]
        lower, upper = np.where(deeper, one, other), np.where(deeper, other, one)
        level = depth[lower] == depth[upper]
        pairs.append(np.stack([lower[level], upper[level]]))
        apart = lower != upper
        one, other = above[lower][apart], np.where(level, above[upper], upper)[apart]
        one, other = np.unique(np.stack([one, other]), axis=1) if len(one) else (one, other)
    tied = np.concatenate(pairs, axis=1)
    graph = scipy.sparse.coo_array((np.ones(tied.shape[1], np.int8), tied), shape=(len(stem), len(stem)))
    label = connected_components(graph, directed=False)[1]
    first = np.unique(label, return_index=True)[1]  # bones are sorted by depth
    number = np.empty(len(first), np.int32)
    number[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    return np.asarray(number[label])


@compiled
@no_type_check  # numba cannot compile a type-checked function
def _strain(parent, place, ends, points):
    """Compute the distance of the edges across each joint from it, in units of their lengths."""
    away, length = np.zeros(len(parent)), np.full(len(parent), 1e-30)
    for e in range(len(ends)):
        low, high = min(ends[e]), max(ends[e])
        while low != high:
            away[high] += ((points[e].sum(axis=0) / 2 - place[high]) ** 2).sum()
            length[high] += ((points[e, 0] - points[e, 1]) ** 2).sum()
            low, high = min(low, parent[high]), max(low, parent[high])
    return np.sqrt(away / length)


@compiled
@no_type_check
def _frames(above, joint, bends):
    frame, place = np.empty((len(joint), 3, 3)), joint.copy()
    frame[0] = np.eye(3)
    for j in range(1, len(joint)):
        i = above[j]
        place[j] = place[i] + frame[i] @ (joint[j] - joint[i])
        frame[j] = frame[i]
        if bends[j].any():
            frame[j] = frame[i] @ exponential(bends[j])
    return frame, place


@compiled
@no_type_check
def exponential(v):
    """Compute exp[v]× by Rodrigues' formula."""
    angle = np.sqrt((v**2).sum())
    s, d = (np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2) if angle > 1e-3 else (1 - angle**2 / 6, 0.5)
    cross = cross_matrix(v)
    return np.eye(3) + s * cross + d * (cross @ cross)


@compiled
@no_type_check
def cross_matrix(v):
    """Return the matrix of v ×."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
