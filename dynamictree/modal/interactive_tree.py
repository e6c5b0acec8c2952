"""Tree prepared for interaction: computes how far each group of forces moves bones and voxels."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Complex128, Float32, Float64, Int64

from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.force import (
    CarriedPoint,
    Contact,
    Drag,
    Force,
    contact_at_point,
    contact_at_voxel,
    drag_force_n,
    modal_force,
    require_finite,
)
from dynamictree.modal.local_bend import Bend
from dynamictree.modal.step import State
from dynamictree.modal.system import ModalSystem

if TYPE_CHECKING:  # modules that import numba
    from dynamictree.modal.bones import Bones
    from dynamictree.modal.joints import Joints
    from dynamictree.modal.reach import Reach
    from dynamictree.rig.pose import Weights
    from dynamictree.rig.rig import Rig


@dataclass(frozen=True, kw_only=True)
class Locality:
    """Centre and falloff of a group's response."""

    seed_voxel: int
    falloff_m: float


@dataclass(frozen=True, kw_only=True)
class ForceGroup:
    """Forces that share modal coordinates; a group without a locality moves the whole tree."""

    locality: Locality | None = None
    forces: tuple[Force, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Reached:
    """Displacement at rest of the point of a drag by displacement [m]."""

    wanted_m: Float64[np.ndarray, " 3"]
    reached_m: Float64[np.ndarray, " 3"]
    beyond_m: float  # distance of the target beyond the length of the branches from the root [m]

    @property
    def why(self) -> str:
        """Reason why the point may miss its target."""
        if self.beyond_m > 0:
            return f"the target is {self.beyond_m:.3g} m too far from the root: branches do not stretch"
        return "the branches between the point and the root are too stiff in this direction"


@dataclass(frozen=True, kw_only=True)
class Rest:
    """Static solution of a group under a drag by displacement."""

    bend: Float64[np.ndarray, "n 3"]
    q: Complex128[np.ndarray, " M"]
    reached: Reached


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Response: modal coordinates and local bends per frame and group, and the start state of a next run."""

    groups: tuple[ForceGroup, ...]
    q: Complex128[np.ndarray, "T G M"]
    final: State
    bends: tuple[Float64[np.ndarray, "T n 3"], ...]  # per group; n = 0 without bending joints
    final_bends: tuple[Bend, ...]
    reached: tuple[Reached, ...] = ()  # per drag by displacement, in the order of the groups' forces


@dataclass(frozen=True)
class InteractiveTree:
    """Tree prepared once per spectrum for many requests. Local responses and bends need the rig."""

    system: ModalSystem = field(repr=False)
    rig: "Rig | None" = field(default=None, repr=False)
    mesh: TriangleMesh | None = field(default=None, repr=False)  # mesh of the rig

    @cached_property
    def bones(self) -> "Bones":
        """Rig's bones, prepared for forces.

        Raises:
            InputError: the tree has no rig.
        """
        if self.rig is None:
            raise InputError("without its mesh a tree has no bones: they are found in the mesh")
        from dynamictree.modal.bones import bones_of

        return bones_of(self.rig)

    @cached_property
    def joints(self) -> "Joints":
        """Joints that a pull bends."""
        from dynamictree.modal.joints import joints_of

        bones = self.bones
        assert self.mesh is not None  # set together with the rig
        return joints_of(bones, self.mesh, self.system.shapes)

    def reaches(self, groups: Sequence[ForceGroup]) -> "list[Reach | None]":
        """Return each group's reach on the bones; None for a group that moves the whole tree."""
        return [None if group.locality is None else self._reach(group.locality) for group in groups]

    def _reach(self, place: Locality) -> "Reach":
        from dynamictree.modal.reach import reach_of

        seed = int(contact_at_voxel(self.system.grid, place.seed_voxel).rows[0])
        return reach_of(self.bones.skeleton, int(self.bones.of_voxel[seed]), place.falloff_m)

    def weights(self, groups: Sequence[ForceGroup]) -> Float32[np.ndarray, "G V"]:
        """Return the weight of each voxel in each group, which is that of its bone."""
        everywhere = np.ones(len(self.system.grid), np.float32)
        rows = [
            everywhere if reach is None else reach.weights[self.bones.of_voxel].astype(np.float32)
            for reach in self.reaches(groups)
        ]
        return np.stack(rows) if rows else np.zeros((0, len(everywhere)), np.float32)

    def voxels(self, answer: Answer) -> Iterator[Float32[np.ndarray, "V 3"]]:
        """Yield the displacement of every voxel, frame by frame [m]."""
        return self.bent(answer, self.system.grid.centres_m, self.bones.voxels)

    def bent(
        self, answer: Answer, points: Float32[np.ndarray, "N 3"], weights: "Weights"
    ) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Yield the displacement of points that bones carry, frame by frame [m]."""
        from dynamictree.modal.bones import turns_of
        from dynamictree.rig.pose import carried, poses

        bones, joints, reaches = self.bones, self.joints, self.reaches(answer.groups)
        chains = [self.chain(group) for group in answer.groups]
        for frame, q in enumerate(answer.q):
            bends = np.zeros((len(joints.parent), 3))
            for rows, turns in zip(chains, answer.bends, strict=True):
                bends[rows[: turns.shape[1]]] += turns[frame]
            turns = turns_of(bones, reaches, q).astype(np.float32)
            stance = joints.bent(poses(bones.skeleton, turns[None]), bends)
            yield carried(bones.skeleton, stance, 0, points, weights)

    def chain(self, group: ForceGroup) -> Int64[np.ndarray, " n"]:
        """Return the joints from a group's own towards the root, which a pull bends."""
        if group.locality is None:
            return np.zeros(0, np.int64)
        return self.joints.chain(int(contact_at_voxel(self.system.grid, group.locality.seed_voxel).rows[0]))

    def hold(self, system: ModalSystem, group: ForceGroup, drag: Drag, *, near: "Rest | None" = None) -> "Rest":
        """Solve for the bends of the joints that fix a point; without a locality, use the modes alone.

        `system` is this tree's, with current physics; `near`, the solution for a nearby target, is the first guess.
        """
        from dynamictree.modal.pull import grip_at, pull_to
        from dynamictree.rig.pose import Weights

        point, still = self.grip_point(drag.at), np.zeros(system.num_modes, np.complex128)
        wanted = require_finite("displacement_m", drag.displacement_m or (0.0, 0.0, 0.0))
        if group.locality is not None:
            pull = pull_to(
                grip_at(self.joints, self.chain(group), point), wanted, near=None if near is None else near.bend
            )
            reached = Reached(wanted_m=wanted, reached_m=pull.reached_m, beyond_m=pull.beyond_m)
            return Rest(bend=pull.bend, q=still, reached=reached)
        q = modal_force(system, drag.at, drag_force_n(system, drag)) / system.stiffness
        answer = Answer(
            groups=(group,), q=q[None, None], bends=(np.zeros((1, 0, 3)),), final=State.at_rest(0, 0), final_bends=()
        )
        moved = next(
            self.bent(answer, point.point_m[None], Weights(rows=point.bones[None], shares=point.weights[None]))
        )[0].astype(np.float64)
        return Rest(bend=np.zeros((0, 3)), q=q, reached=Reached(wanted_m=wanted, reached_m=moved, beyond_m=0.0))

    def grip_point(self, at: Contact) -> CarriedPoint:
        """Return the point that a drag by displacement fixes: the contact's, or else its first voxel."""
        row, voxels = int(at.rows[0]), self.bones.voxels
        if at.grip is not None:
            return at.grip
        return CarriedPoint(point_m=self.system.grid.centres_m[row], bones=voxels.rows[row], weights=voxels.shares[row])

    def contact_at_vertex(self, vertices: Float32[np.ndarray, "N 3"], vertex: int, *, radius_m: float = 0.0) -> Contact:
        """Create a contact for a vertex; the force acts at the nearest voxel of the joint that carries it."""
        joints, (x, y, z) = self.joints, vertices[vertex].tolist()
        assert self.rig is not None
        rows, shares = self.rig.vertices.rows[vertex], self.rig.vertices.shares[vertex]
        joint, own = int(joints.of_bone[rows[shares.argmax()]]), np.zeros(0, np.int64)
        while joint > 0 and len(own) == 0:
            own = np.flatnonzero(joints.of_voxel == joint)
            joint = int(joints.parent[joint])
        if len(own) and radius_m == 0:
            away = np.linalg.norm(self.system.grid.centres_m[own] - vertices[vertex], axis=1)
            at = contact_at_voxel(self.system.grid, int(own[away.argmin()]))
        else:
            at = contact_at_point(self.system.grid, (x, y, z), radius_m=radius_m)
        return replace(at, grip=CarriedPoint(point_m=vertices[vertex], bones=rows, weights=shares))
