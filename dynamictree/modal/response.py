"""Response to forces, which are grouped by location: modal coordinates over time."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64

from dynamictree.errors import InputError
from dynamictree.modal.force import Drag, Force, WindField, davis_state, equilibrium, generalised_force, share_of_steps
from dynamictree.modal.interactive_tree import Answer, ForceGroup, InteractiveTree, Locality, Reached
from dynamictree.modal.local_bend import Bend, drive, joints_step
from dynamictree.modal.step import STEPS, State, run
from dynamictree.modal.system import ModalSystem
from dynamictree.requests import Integrator

Start = Literal["rest", "held", "davis"]


def with_bin_zero(q: Complex128[np.ndarray, "*rows M"]) -> Float64[np.ndarray, "*rows K 2"]:
    """Convert coordinates to real and imaginary parts by frequency bin; bin 0 is no mode and 0."""
    coordinates = np.zeros((*q.shape[:-1], q.shape[-1] + 1, 2))
    coordinates[..., 1:, 0], coordinates[..., 1:, 1] = q.real, q.imag
    return coordinates


def answer_tensors(answer: Answer) -> dict[str, np.ndarray]:
    """Convert a response to a file's tensors: `q` [G, T, K, 2], `final_q` and `final_q_dot` [G, K, 2], localities.

    `seed_voxel` is -1 and `falloff_m` 0 for a group that moves the whole tree. A group g with bending joints also has
    `bend_g` [T, n, 3] [rad], `final_bend_g` and `final_bend_rate_g` [n, 3].
    """
    places = [group.locality for group in answer.groups]
    bends = {
        f"{name}_{index}": array
        for index, (turns, final) in enumerate(zip(answer.bends, answer.final_bends, strict=True))
        if turns.shape[1]
        for name, array in (("bend", turns), ("final_bend", final.turn), ("final_bend_rate", final.rate))
    }
    return bends | {
        "q": np.ascontiguousarray(with_bin_zero(answer.q).transpose(1, 0, 2, 3)),
        "final_q": with_bin_zero(answer.final.q),
        "final_q_dot": with_bin_zero(answer.final.q_dot),
        "seed_voxel": np.array([-1 if at is None else at.seed_voxel for at in places], np.int32),
        "falloff_m": np.array([0.0 if at is None else at.falloff_m for at in places]),
    }


def group_forces(forces: Sequence[Force], *, falloff_m: float | None) -> tuple[ForceGroup, ...]:
    """Group forces by voxel; wind, and all forces without a falloff, move the whole tree."""
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
    start_bends: Sequence[Bend] = (),
    tree: InteractiveTree | None = None,
) -> Answer:
    """Compute the response: modal coordinates at times 0, dt, … and the state after the last step.

    The start is at rest; `held`: in equilibrium with the forces at time 0; `davis`: in the initial state of Davis et
    al.; or a state of these groups, with their bends.

    Drags by displacement and bends of a start need `tree` with its rig, whose joints they bend.

    Raises:
        InputError: a force, dt or the start is invalid, or the rig is missing.
        UnstableTimestep: the integrator diverges at this dt.
    """
    step = STEPS[integrator](system, dt_s)
    tree = tree or InteractiveTree(system)
    if start != "davis":
        solved, aims, reached = _forces_and_bends(system, groups, dt_s, num_frames, tree)
    else:
        solved, aims, reached = list(groups), [np.zeros((num_frames, 0, 3)) for _ in groups], ()
    pushed = np.zeros((num_frames, len(groups), system.num_modes), np.complex128)  # f, [T, G, M]
    for index, group in enumerate(solved):
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
    begun = [_first_bend(start_bends[index : index + 1], aim, pulled=start == "held") for index, aim in enumerate(aims)]
    swings = [
        _bends(system, tree, group, bend, aim, dt_s) for group, bend, aim in zip(groups, begun, aims, strict=True)
    ]
    return Answer(
        groups=tuple(groups),
        q=q,
        final=final,
        bends=tuple(turns for turns, _ in swings),
        final_bends=tuple(last for _, last in swings),
        reached=reached,
    )


def _forces_and_bends(
    system: ModalSystem, groups: Sequence[ForceGroup], dt_s: float, num_frames: int, tree: InteractiveTree
) -> tuple[list[ForceGroup], list[Float64[np.ndarray, "T n 3"]], tuple[Reached, ...]]:
    """Return the forces on the modes, and the bends per step of drags by displacement."""
    solved, aims, reached = [], [], []
    for group in groups:
        forces: list[Force] = []
        aim = np.zeros((num_frames, 0, 3))
        for force in group.forces:
            if not isinstance(force, Drag) or force.displacement_m is None or force.force_n is not None:
                forces.append(force)
                continue
            equilibrium = tree.hold(system, group, force)
            reached.append(equilibrium.reached)
            if group.locality is None:
                forces.append(force)
                continue
            part = share_of_steps(force.start_s, force.duration_s, dt_s, num_frames)[:, None, None] * equilibrium.bend
            aim = aim + part if aim.shape[1] else part
        solved.append(ForceGroup(locality=group.locality, forces=tuple(forces)))
        aims.append(aim)
    return solved, aims, tuple(reached)


def _first_bend(given: Sequence[Bend], aim: Float64[np.ndarray, "T n 3"], *, pulled: bool) -> Bend:
    if given and len(given[0].turn):
        return given[0]
    straight = Bend.straight(aim.shape[1])
    return Bend(turn=aim[0], rate=straight.rate) if pulled else straight


def _bends(
    system: ModalSystem,
    tree: InteractiveTree,
    group: ForceGroup,
    begin: Bend,
    pull: Float64[np.ndarray, "T m 3"],
    dt_s: float,
) -> tuple[Float64[np.ndarray, "T n 3"], Bend]:
    if pull.shape[1] == 0 and len(begin.turn):
        pull = np.zeros((len(pull), *begin.turn.shape))
    if pull.shape[1] == 0:
        return pull, begin
    chain = tree.chain(group)
    if not len(chain) == len(begin.turn) == pull.shape[1]:
        raise InputError(f"the state bends {len(begin.turn)} joints; {len(chain)} lie under this place")
    return drive(joints_step(system, tree.joints.omega(system, chain), dt_s), begin, pull)


def _davis(system: ModalSystem, groups: Sequence[ForceGroup]) -> State:
    """Return Davis' initial state for each group's single force, which then does not act."""
    states = []
    for group in groups:
        if len(group.forces) != 1 or isinstance(group.forces[0], WindField):
            raise InputError(
                f"{len(group.forces)} forces at one place; Davis' start is of one impulse or drag, and no wind"
            )
        states.append(davis_state(system, group.forces[0]))
    return State(q=np.concatenate([s.q for s in states]), q_dot=np.concatenate([s.q_dot for s in states]))
