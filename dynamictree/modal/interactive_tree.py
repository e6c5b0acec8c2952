"""A tree prepared for interaction: which bones and voxels each group of forces moves, and how far."""

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
    finite,
    generalised,
)
from dynamictree.modal.local_bend import Bend
from dynamictree.modal.step import State
from dynamictree.modal.system import ModalSystem, displacement

if TYPE_CHECKING:  # what brings numba
    from dynamictree.modal.bones import Bones
    from dynamictree.modal.frames import VertexFrames
    from dynamictree.modal.joints import Joints
    from dynamictree.modal.reach import Reach
    from dynamictree.rig.pose import Weights
    from dynamictree.rig.rig import Rig


@dataclass(frozen=True, kw_only=True)
class Locality:
    """Where a group's answer is centred, and how fast it fades."""

    seed_voxel: int
    falloff_m: float


@dataclass(frozen=True, kw_only=True)
class ForceGroup:
    """Forces that share modal coordinates; without a locality they move the whole tree."""

    locality: Locality | None = None
    forces: tuple[Force, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Reached:
    """Where a drag by displacement holds its point at rest [m from rest]."""

    wanted_m: Float64[np.ndarray, " 3"]
    reached_m: Float64[np.ndarray, " 3"]
    beyond_m: float  # how far the target lies beyond the length of the branches between it and the root [m]

    @property
    def why(self) -> str:
        """Why the point may rest elsewhere."""
        if self.beyond_m > 0:
            return f"the target is {self.beyond_m:.3g} m too far from the root: branches do not stretch"
        return "the branches between the point and the root are too stiff in this direction"


@dataclass(frozen=True, kw_only=True)
class Rest:
    """A group at rest under a drag by displacement."""

    bend: Float64[np.ndarray, "n 3"]
    q: Complex128[np.ndarray, " M"]
    reached: Reached


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Modal coordinates and local bends per frame and group, and the state that the next run begins with."""

    groups: tuple[ForceGroup, ...]
    q: Complex128[np.ndarray, "T G M"]
    final: State
    bends: tuple[Float64[np.ndarray, "T n 3"], ...]  # per group; n = 0 where no joint bends
    final_bends: tuple[Bend, ...]
    reached: tuple[Reached, ...] = ()  # per drag by displacement, in the order of the groups' forces


@dataclass(frozen=True)
class InteractiveTree:
    """Prepared once per spectrum and used for many requests. What is local to a branch, or bends, needs the rig."""

    system: ModalSystem = field(repr=False)
    rig: "Rig | None" = field(default=None, repr=False)
    mesh: TriangleMesh | None = field(default=None, repr=False)  # the rig's

    @cached_property
    def bones(self) -> "Bones":
        """The rig's bones under forces.

        Raises:
            InputError: the tree has no rig.
        """
        if self.rig is None:
            raise InputError("without its mesh a tree has no bones: they are found in the mesh")
        from dynamictree.modal.bones import bones_of

        return bones_of(self.rig)

    @cached_property
    def joints(self) -> "Joints":
        """The joints that a pull bends."""
        from dynamictree.modal.joints import joints_of

        bones = self.bones
        assert self.mesh is not None  # as the rig is not
        return joints_of(bones, self.mesh, self.system.shapes)

    def reaches(self, groups: Sequence[ForceGroup]) -> "list[Reach | None]":
        """How each group of forces takes part in the bones; None where it moves the whole tree."""
        return [None if group.locality is None else self._reach(group.locality) for group in groups]

    def _reach(self, place: Locality) -> "Reach":
        from dynamictree.modal.reach import reach_of

        seed = int(contact_at_voxel(self.system.grid, place.seed_voxel).rows[0])
        return reach_of(self.bones.skeleton, int(self.bones.of_voxel[seed]), place.falloff_m)

    def weights(self, groups: Sequence[ForceGroup]) -> Float32[np.ndarray, "G V"]:
        """Weight of each voxel in each group, that of its bone."""
        everywhere = np.ones(len(self.system.grid), np.float32)
        rows = [
            everywhere if reach is None else reach.weights[self.bones.of_voxel].astype(np.float32)
            for reach in self.reaches(groups)
        ]
        return np.stack(rows) if rows else np.zeros((0, len(everywhere)), np.float32)

    def voxels(self, answer: Answer, *, warp: bool = False) -> Iterator[Float32[np.ndarray, "V 3"]]:
        """Displacement of every voxel, frame after frame [m]."""
        frames_at_once = 32  # of plain superposition: one matrix product, 15 MB at 40,000 voxels
        grid = self.system.grid
        if warp:
            yield from self.bent(answer, grid.centres_m, self.bones.voxels)
            return
        weights = self.weights(answer.groups)
        for first in range(0, len(answer.q), frames_at_once):
            some = answer.q[first : first + frames_at_once]
            moved = np.zeros((len(some), len(grid), 3), np.float32)
            for index, row in enumerate(weights):
                moved += row[:, None] * displacement(self.system.shapes, some[:, index])
            yield from moved

    def superposed(self, answer: Answer, vertices: "VertexFrames") -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Displacement of a mesh's vertices without warp, frame after frame [m]."""
        weights = None
        if any(group.locality for group in answer.groups):
            one = np.ones(len(self.bones.skeleton))
            weights = vertices.weights(np.stack([r.weights if r else one for r in self.reaches(answer.groups)]))
        for q in answer.q:
            yield vertices.displacement(q, weights)

    def bent(
        self, answer: Answer, points: Float32[np.ndarray, "N 3"], weights: "Weights"
    ) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Displacement of points that bones carry, frame after frame [m]."""
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
        """Joints from a group's own towards the root, which a pull bends."""
        if group.locality is None:
            return np.zeros(0, np.int64)
        return self.joints.chain(int(contact_at_voxel(self.system.grid, group.locality.seed_voxel).rows[0]))

    def hold(self, system: ModalSystem, group: ForceGroup, drag: Drag, *, near: "Rest | None" = None) -> "Rest":
        """Hold a point by bends of the joints that carry it; without a locality, by the modes alone.

        Args:
            system: this tree's, with the physics of the moment.
            group: the drag's.
            drag: by displacement.
            near: the answer for a target close by.
        """
        from dynamictree.modal.pull import grip_at, pull_to
        from dynamictree.rig.pose import Weights

        point, still = self.drawn(drag.at), np.zeros(system.num_modes, np.complex128)
        wanted = finite("displacement_m", drag.displacement_m or (0.0, 0.0, 0.0))
        if group.locality is not None:
            pull = pull_to(
                grip_at(self.joints, self.chain(group), point), wanted, near=None if near is None else near.bend
            )
            reached = Reached(wanted_m=wanted, reached_m=pull.reached_m, beyond_m=pull.beyond_m)
            return Rest(bend=pull.bend, q=still, reached=reached)
        q = generalised(system, drag.at, drag_force_n(system, drag)) / system.stiffness
        answer = Answer(
            groups=(group,), q=q[None, None], bends=(np.zeros((1, 0, 3)),), final=State.at_rest(0, 0), final_bends=()
        )
        moved = next(
            self.bent(answer, point.point_m[None], Weights(rows=point.bones[None], shares=point.weights[None]))
        )[0].astype(np.float64)
        return Rest(bend=np.zeros((0, 3)), q=q, reached=Reached(wanted_m=wanted, reached_m=moved, beyond_m=0.0))

    def drawn(self, at: Contact) -> CarriedPoint:
        """The point that a drag by displacement holds: the one of the contact, else its first voxel."""
        row, voxels = int(at.rows[0]), self.bones.voxels
        if at.drawn is not None:
            return at.drawn
        return CarriedPoint(point_m=self.system.grid.centres_m[row], bones=voxels.rows[row], weights=voxels.shares[row])

    def contact_at_vertex(self, vertices: Float32[np.ndarray, "N 3"], vertex: int, *, radius_m: float = 0.0) -> Contact:
        """Where a vertex is pulled: the force acts at the nearest voxel of the joint that carries it."""
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
        return replace(at, drawn=CarriedPoint(point_m=vertices[vertex], bones=rows, weights=shares))
