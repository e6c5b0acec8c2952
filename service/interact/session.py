"""State of one interactive stream: forces go in, one frame per step comes out.

Only the event loop calls `Session`'s methods. The slow part, the force of a message, is computed by `force_of` in a
thread; `force_of` does not change the session.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Complex128, Float64

from dynamictree.modal.force import Contact, Drag, generalised_force
from dynamictree.modal.interactive_tree import ForceGroup, InteractiveTree, Locality, Reached, Rest
from dynamictree.modal.local_bend import Bend, free_step, joints_step
from dynamictree.modal.response import group_forces, with_bin_zero
from dynamictree.modal.step import State, Step, run
from dynamictree.modal.system import ModalSystem
from service.http.problems import ProblemError
from service.interact.forces import MAX_GROUPS, ForcePayload, library_force, reached_payload

SETTLED_M = 1e-4
"""A group is dropped once none of its voxels can move further than this [m]."""

WINDOW = 8
"""Frames that may be sent without an acknowledgement: 130 ms at 60 Hz."""

TRACKING_S = 0.015
"""Time constant with which a grip follows its pointer: a frame at 60 Hz covers two thirds of the rest."""

STRAIGHT_RAD = 1e-4
"""Angle below which a joint counts as straight [rad]."""


@dataclass(frozen=True, kw_only=True)
class Hold:
    """Target shape of a group that a drag by displacement holds."""

    q: Complex128[np.ndarray, " M"]
    bend: Float64[np.ndarray, "n 3"]
    omega: Float64[np.ndarray, " n"]  # angular frequencies of the joints after a release [rad/s]
    reached: Reached


@dataclass(frozen=True, kw_only=True)
class ModalForce:
    """A force of a message in modal coordinates."""

    kind: str
    locality: Locality | None
    acceleration: Complex128[np.ndarray, " M"]  # generalised force over modal mass [1/s²]
    hold: Hold | None = None


class Grips:
    """Dragged points of one stream; each solution is the initial guess of the next."""

    def __init__(self, tree: Callable[[], InteractiveTree], system: ModalSystem) -> None:
        self.tree = tree  # returns the tree with its rig, which the first pull computes
        self.system = system
        self._last: tuple[object, Rest] | None = None

    def hold(self, drag: Drag, group: ForceGroup) -> Hold:
        """Solve a drag by displacement in the bent shape."""
        grip = None if drag.at.grip is None else drag.at.grip.point_m.tobytes()
        key = (group.locality, drag.at.rows.tobytes(), grip)
        near = self._last[1] if self._last is not None and self._last[0] == key else None
        tree = self.tree()
        equilibrium = tree.hold(self.system, group, drag, near=near)
        self._last = (key, equilibrium)
        omega = tree.joints.omega(self.system, tree.chain(group))
        return Hold(q=equilibrium.q, bend=equilibrium.bend, omega=omega, reached=equilibrium.reached)


def force_of(
    payload: ForcePayload,
    system: ModalSystem,
    *,
    dt_s: float,
    falloff_m: float | None,
    vertex_contact: Callable[[int, float], Contact],
    grips: Grips,
) -> ModalForce:
    """Project a message's force onto the modes."""
    if payload.start_s != 0 or payload.duration_s is not None:
        raise ProblemError("validation-failed", "forces of a stream begin now; leave start_s and duration_s out")
    force = library_force(payload, system.grid, vertex_contact)
    (group,) = group_forces([force], falloff_m=falloff_m)
    if isinstance(force, Drag) and force.displacement_m is not None:
        still = np.zeros(system.num_modes, np.complex128)
        return ModalForce(kind="drag", locality=group.locality, acceleration=still, hold=grips.hold(force, group))
    return ModalForce(
        kind=payload.kind,
        locality=group.locality,
        acceleration=generalised_force(system, force, dt_s=dt_s, num_frames=1)[0] / system.modal_mass,
    )


@dataclass(kw_only=True)
class Session:
    """Modal coordinates of every group that moves, and the forces that act on them."""

    system: ModalSystem
    step: Step
    frame: int = 0
    skipped: int = 0
    unacknowledged: deque[int] = field(default_factory=deque)
    woken: asyncio.Event = field(default_factory=asyncio.Event)
    localities: list[Locality | None] = field(default_factory=list)  # one per row of `state`
    state: State = field(init=False)
    bends: list[Bend] = field(default_factory=list)  # one per row of `state`
    swings: dict[Locality | None, Step] = field(default_factory=dict)  # steps of the joints after a release
    constant: dict[str, ModalForce] = field(default_factory=dict)  # forces by kind; they act until released
    impulses: list[ModalForce] = field(default_factory=list)  # forces that act during the next step
    largest_m: Float64[np.ndarray, " M"] = field(init=False)  # largest displacement per unit of each coordinate [m]

    def __post_init__(self) -> None:
        self.state = State.at_rest(0, self.system.num_modes)
        self.largest_m = np.linalg.norm(self.system.shapes, axis=2).max(axis=0)

    @property
    def at_rest(self) -> bool:
        """Return whether no group moves and no force acts."""
        return not (self.localities or self.constant or self.impulses)

    def push(self, force: ModalForce) -> None:
        """Apply a force from the next step on."""
        if force.locality not in self.localities:
            if len(self.localities) >= MAX_GROUPS:
                raise ProblemError("validation-failed", f"{MAX_GROUPS} places still swing; push one of them, or wait")
            self.localities.append(force.locality)
            self.bends.append(Bend.straight())
            rest = np.zeros((1, self.system.num_modes), np.complex128)
            self.state = State(q=np.vstack([self.state.q, rest]), q_dot=np.vstack([self.state.q_dot, rest]))
        if force.hold is not None:
            index = self.localities.index(force.locality)
            if len(self.bends[index].turn) != len(force.hold.bend):
                self.bends[index] = Bend.straight(len(force.hold.bend))
            self.swings[force.locality] = joints_step(self.system, force.hold.omega, self.step.dt_s)
        if force.kind == "impulse":
            self.impulses.append(force)
        else:
            self.constant[force.kind] = force
        self.woken.set()

    def release(self, kind: str) -> None:
        """End the drag or the wind."""
        self.constant.pop(kind, None)

    def acknowledge(self, frame: int) -> None:
        """Note that the client has drawn every frame up to this one."""
        while self.unacknowledged and self.unacknowledged[0] <= frame:
            self.unacknowledged.popleft()

    def tick(self) -> None:
        """Advance all groups by one step, and drop those that have settled."""
        self.frame += 1
        acceleration = np.zeros((1, *self.state.q.shape), np.complex128)
        for force in (*self.constant.values(), *self.impulses):
            acceleration[0, self.localities.index(force.locality)] += force.acceleration
        self.impulses.clear()
        _, moved = run(self.step, self.state, acceleration)
        drag = self.constant.get("drag")
        pulled_group = self.localities.index(drag.locality) if drag is not None and drag.hold is not None else None
        for index, locality in enumerate(self.localities):
            if len(self.bends[index].turn) and index != pulled_group:
                self.bends[index] = free_step(self.swings[locality], self.bends[index])
        if pulled_group is not None and drag is not None and drag.hold is not None:
            self._follow(pulled_group, drag.hold, moved)
        self.state = moved
        self._drop_settled()

    def _follow(self, index: int, hold: Hold, moved: State) -> None:
        """Move a pulled group towards its target shape; set matching rates, so that a release does not jump."""
        share, dt_s = 1 - np.exp(-self.step.dt_s / TRACKING_S), self.step.dt_s
        change = share * (hold.q - self.state.q[index])
        moved.q[index], moved.q_dot[index] = self.state.q[index] + change, change / dt_s
        before = self.bends[index].turn
        bent = share * (hold.bend - before)
        self.bends[index] = Bend(turn=before + bent, rate=bent / dt_s)

    def _drop_settled(self) -> None:
        swing = np.abs(self.state.q) + np.abs(self.state.q_dot) / self.system.omega
        moving = swing @ self.largest_m >= SETTLED_M
        pushed = {force.locality for force in self.constant.values()}
        bent = [np.abs(bend.turn).max(initial=0) > STRAIGHT_RAD for bend in self.bends]
        rows = [n for n, at in enumerate(self.localities) if moving[n] or at in pushed or bent[n]]
        if len(rows) < len(self.localities):
            self.localities = [self.localities[n] for n in rows]
            self.bends = [self.bends[n] for n in rows]
            self.state = State(q=self.state.q[rows], q_dot=self.state.q_dot[rows])

    def next_frame(self) -> dict[str, object] | None:
        """Return the message of this frame; None if too many earlier frames are unacknowledged."""
        if len(self.unacknowledged) >= WINDOW:
            self.skipped += 1
            return None
        self.unacknowledged.append(self.frame)
        q = with_bin_zero(self.state.q)  # [G, K, 2]
        groups = [
            {"locality": at, "q": q[n], "bend": turn if len(turn := self.bends[n].turn) else None}
            for n, at in enumerate(self.localities)
        ]
        drag = self.constant.get("drag")
        message = {"type": "frame", "frame": self.frame, "skipped": self.skipped, "groups": groups}
        if drag is not None and drag.hold is not None:
            message["reached"] = reached_payload(drag.hold.reached)
        self.skipped = 0
        return message
