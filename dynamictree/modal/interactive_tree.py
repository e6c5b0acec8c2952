"""A tree prepared for interaction: which bones and voxels each group of forces moves, and how far."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Complex128, Float32, Float64, Int64

from dynamictree.modal.bone_attachment import BoneAttachment
from dynamictree.modal.bones import Bones, bones_of
from dynamictree.modal.force import CarriedPoint, Contact, Force, contact_at_point, contact_at_voxel
from dynamictree.modal.local_bend import Bend
from dynamictree.modal.locality import Branching, branching, poke_weights
from dynamictree.modal.step import State
from dynamictree.modal.system import ModalSystem, displacement

if TYPE_CHECKING:
    from dynamictree.modal.frames import VertexFrames
    from dynamictree.modal.pull import Grip

FRAMES_AT_ONCE = 32  # of plain superposition: one matrix product, 15 MB at 40,000 voxels


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
    """Prepared once per spectrum and used for many requests; data that only displacements need are made on demand."""

    system: ModalSystem = field(repr=False)

    @cached_property
    def branching(self) -> Branching:
        """Branching structure of the tree."""
        return branching(self.system)

    @cached_property
    def bones(self) -> Bones:
        """The bones, each of which rotates as one rigid body."""
        return bones_of(self.system)

    def weights(self, groups: Sequence[ForceGroup]) -> Float32[np.ndarray, "G V"]:
        """Weight of each voxel in each group."""
        everywhere = np.ones(len(self.system.grid), np.float32)
        rows = [
            poke_weights(self.branching, group.locality.seed_voxel, group.locality.falloff_m)
            if group.locality
            else everywhere
            for group in groups
        ]
        return np.stack(rows) if rows else np.zeros((0, len(everywhere)), np.float32)

    def voxels(self, answer: Answer, *, warp: bool = False) -> Iterator[Float32[np.ndarray, "V 3"]]:
        """Displacement of every voxel, frame after frame [m]."""
        grid = self.system.grid
        if warp:
            own = BoneAttachment(rows=self.bones.bone_of_voxel[:, None], weights=np.ones((len(grid), 1), np.float32))
            yield from self.bent(answer, grid.centres_m, own)
            return
        weights = self.weights(answer.groups)
        for first in range(0, len(answer.q), FRAMES_AT_ONCE):
            some = answer.q[first : first + FRAMES_AT_ONCE]
            moved = np.zeros((len(some), len(grid), 3), np.float32)
            for index, row in enumerate(weights):
                moved += row[:, None] * displacement(self.system.shapes, some[:, index])
            yield from moved

    def superposed(self, answer: Answer, vertices: "VertexFrames") -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Displacement of a mesh's vertices without warp, frame after frame [m]."""
        weights = None
        if any(group.locality for group in answer.groups):
            weights = vertices.weights(self.weights(answer.groups))
        for q in answer.q:
            yield vertices.displacement(q, weights)

    def bent(
        self, answer: Answer, points: Float32[np.ndarray, "N 3"], attachment: BoneAttachment
    ) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Displacement of points that bones carry, frame after frame [m]."""
        from dynamictree.modal.warp import bend, bone_turns, bone_weights, pose  # brings numba

        per_bone = bone_weights(self.bones, self.weights(answer.groups))
        chains = [self.chain(group) for group in answer.groups]
        for frame, q in enumerate(answer.q):
            bends = np.zeros_like(self.bones.joint_m)
            for rows, turns in zip(chains, answer.bends, strict=True):
                bends[rows[: turns.shape[1]]] += turns[frame]
            stance = pose(self.bones, bone_turns(self.bones, per_bone, q), bends)
            yield bend(self.bones, stance, points, attachment.rows, attachment.weights)

    def chain(self, group: ForceGroup) -> Int64[np.ndarray, " n"]:
        """Bones from a group's own towards the root, whose joints a pull may bend."""
        from dynamictree.modal.bone_chain import rows_to_root  # brings numba

        if group.locality is None:
            return np.zeros(0, np.int64)
        return rows_to_root(self.bones, int(self.bones.bone_of_voxel[group.locality.seed_voxel]))

    def grip(self, system: ModalSystem, group: ForceGroup, at: Contact) -> "Grip":
        """Prepare a place for drags by displacement in the bent shape.

        Args:
            system: this tree's, with the physics of the moment.
            group: the drag's; without a locality only the modes give way.
            at: where the drag acts.
        """
        from dynamictree.modal.pull import grip_at  # brings numba
        from dynamictree.modal.warp import bone_weights

        weights = bone_weights(self.bones, self.weights([group]))
        return grip_at(system, self.bones, at, weights, self.chain(group))

    def contact_at_vertex(
        self, attachment: BoneAttachment, vertices: Float32[np.ndarray, "N 3"], vertex: int, *, radius_m: float = 0.0
    ) -> Contact:
        """Where a vertex is pulled: the force acts at the nearest voxel of the bone that carries most of it."""
        x, y, z = vertices[vertex].tolist()
        bones, weights = attachment.rows[vertex], attachment.weights[vertex]
        own = np.flatnonzero(self.bones.bone_of_voxel == bones[weights.argmax()])
        if weights.any() and radius_m == 0:
            away = np.linalg.norm(self.system.grid.centres_m[own] - vertices[vertex], axis=1)
            at = contact_at_voxel(self.system.grid, int(own[away.argmin()]))
        else:
            at = contact_at_point(self.system.grid, (x, y, z), radius_m=radius_m)
        return replace(at, drawn=CarriedPoint(point_m=vertices[vertex], bones=bones, weights=weights))
