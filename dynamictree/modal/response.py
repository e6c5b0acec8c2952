"""From forces to motion: who is pushed together, how it swings, where every voxel goes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float32, Float64

from dynamictree.errors import InputError
from dynamictree.modal.force import Force, WindField, davis_state, equilibrium, generalised_force
from dynamictree.modal.locality import Branching, branching, poke_weights
from dynamictree.modal.skeleton import Bones, bones_of
from dynamictree.modal.step import STEPS, Integrator, State, run
from dynamictree.modal.surface import BoneAttachment
from dynamictree.modal.system import ModalSystem, displacement

Start = Literal["rest", "held", "davis"]
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
class Answer:
    """Modal coordinates a frame and group, and the state that the next run begins with."""

    groups: tuple[ForceGroup, ...]
    q: Complex128[np.ndarray, "T G M"]
    final: State


@dataclass(frozen=True)
class InteractiveTree:
    """Prepared once a spectrum, asked often. What only displacements need is made when first asked for."""

    system: ModalSystem = field(repr=False)

    @cached_property
    def branching(self) -> Branching:
        """Which way the tree grows."""
        return branching(self.system)

    @cached_property
    def bones(self) -> Bones:
        """What turns as one."""
        return bones_of(self.system)

    def weights(self, groups: Sequence[ForceGroup]) -> Float32[np.ndarray, "G V"]:
        """How much each voxel takes part in each group."""
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

    def bent(
        self, answer: Answer, points: Float32[np.ndarray, "N 3"], attachment: BoneAttachment
    ) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Displacement of points that bones carry, frame after frame [m]."""
        from dynamictree.modal.warp import bend, bone_turns, bone_weights, pose  # brings numba

        per_bone = bone_weights(self.bones, self.weights(answer.groups))
        for q in answer.q:
            stance = pose(self.bones, bone_turns(self.bones, per_bone, q))
            yield bend(self.bones, stance, points, attachment.rows, attachment.weights)


def with_bin_zero(q: Complex128[np.ndarray, "*rows M"]) -> Float64[np.ndarray, "*rows K 2"]:
    """Coordinates as they are told: real and imaginary parts by frequency bin; bin 0 is no mode and 0."""
    told = np.zeros((*q.shape[:-1], q.shape[-1] + 1, 2))
    told[..., 1:, 0], told[..., 1:, 1] = q.real, q.imag
    return told


def answer_tensors(answer: Answer) -> dict[str, np.ndarray]:
    """An answer as the tensors of a file: `q` [G, T, K, 2], `final_q` and `final_q_dot` [G, K, 2], and localities.

    `seed_voxel` is -1 and `falloff_m` 0 for a group that moves the whole tree.
    """
    places = [group.locality for group in answer.groups]
    return {
        "q": np.ascontiguousarray(with_bin_zero(answer.q).transpose(1, 0, 2, 3)),
        "final_q": with_bin_zero(answer.final.q),
        "final_q_dot": with_bin_zero(answer.final.q_dot),
        "seed_voxel": np.array([-1 if at is None else at.seed_voxel for at in places], np.int32),
        "falloff_m": np.array([0.0 if at is None else at.falloff_m for at in places]),
    }


def group_forces(forces: Sequence[Force], *, falloff_m: float | None) -> tuple[ForceGroup, ...]:
    """Forces at one voxel go together; wind, and without a falloff everything, moves the whole tree."""
    together: dict[Locality | None, list[Force]] = {}
    for force in forces:
        locality = None
        if falloff_m is not None and not isinstance(force, WindField):
            locality = Locality(seed_voxel=int(force.at.rows[0]), falloff_m=falloff_m)
        together.setdefault(locality, []).append(force)
    return tuple(ForceGroup(locality=locality, forces=tuple(of)) for locality, of in together.items())


def respond(
    system: ModalSystem,
    groups: Sequence[ForceGroup],
    *,
    dt_s: float,
    num_frames: int,
    integrator: Integrator = "exact",
    start: Start | State = "rest",
) -> Answer:
    """Let the tree answer: coordinates at times 0, dt, … and the state after the last step.

    It starts at rest; `held`, in equilibrium with what acts at time 0; by `davis`, in his initial state; or from a
    state of these groups.

    Raises:
        InputError: a force, dt or the start cannot be used.
        UnstableTimestep: the integrator diverges at this dt.
    """
    step = STEPS[integrator](system, dt_s)
    pushed = np.zeros((num_frames, len(groups), system.num_modes), np.complex128)  # f, [T, G, M]
    for index, group in enumerate(groups):
        for force in group.forces:
            pushed[:, index] += generalised_force(system, force, dt_s=dt_s, num_frames=num_frames)
    if isinstance(start, State):
        begin = start
    elif start == "held":
        begin = equilibrium(system, pushed[0])
    elif start == "davis":
        begin, pushed = _davis(system, groups), np.zeros_like(pushed)
    else:
        begin = State.at_rest(len(groups), system.num_modes)
    if begin.q.shape != (len(groups), system.num_modes):
        raise InputError(
            f"the state has {begin.q.shape[0]} groups of {begin.q.shape[1]} modes; "
            f"{len(groups)} of {system.num_modes} are needed"
        )
    q, final = run(step, begin, pushed / system.modal_mass)
    return Answer(groups=tuple(groups), q=q, final=final)


def _davis(system: ModalSystem, groups: Sequence[ForceGroup]) -> State:
    """The state that each group's one force stands for; the force itself then does not act."""
    states = []
    for group in groups:
        if len(group.forces) != 1 or isinstance(group.forces[0], WindField):
            raise InputError(
                f"{len(group.forces)} forces at one place; Davis' start is of one impulse or drag, and no wind"
            )
        states.append(davis_state(system, group.forces[0]))
    return State(q=np.concatenate([s.q for s in states]), q_dot=np.concatenate([s.q_dot for s in states]))
