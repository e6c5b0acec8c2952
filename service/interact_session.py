"""State of one interactive stream: forces go in, one frame per step comes out.

Only the event loop calls `Session`'s methods. What takes long, the force of a message, is computed by `force_of` in a
thread, which changes nothing.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Complex128, Float64

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.force import generalised_force
from dynamictree.modal.response import Locality, group_forces, with_bin_zero
from dynamictree.modal.step import State, Step, run
from dynamictree.modal.system import ModalSystem
from service.http.problems import ProblemError
from service.schemas.forces import MAX_GROUPS, ForcePayload, library_force, locality_payload

SETTLED_M = 1e-4
"""A group is dropped once no voxel can move further than this [m]."""

WINDOW = 8
"""Frames that may be sent without an acknowledgement: 130 ms at 60 Hz."""


@dataclass(frozen=True, kw_only=True)
class ModalForce:
    """A force of a message in modal coordinates."""

    kind: str
    locality: Locality | None
    acceleration: Complex128[np.ndarray, " M"]  # generalised force over modal mass [1/s²]


def force_of(
    payload: ForcePayload,
    system: ModalSystem,
    *,
    dt_s: float,
    falloff_m: float | None,
    mesh: Callable[[], TriangleMesh],
) -> ModalForce:
    """Project a message's force onto the modes.

    Raises:
        InputError, ProblemError: it cannot be used.
    """
    if payload.start_s != 0 or payload.duration_s is not None:
        raise ProblemError("validation-failed", "forces of a stream begin now; leave start_s and duration_s out")
    force = library_force(payload, system.grid, mesh)
    return ModalForce(
        kind=payload.kind,
        locality=group_forces([force], falloff_m=falloff_m)[0].locality,
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
    constant: dict[str, ModalForce] = field(default_factory=dict)  # by kind; act until released
    impulses: list[ModalForce] = field(default_factory=list)  # act for the next step
    largest_m: Float64[np.ndarray, " M"] = field(init=False)  # displacement per unit of each coordinate, anywhere [m]

    def __post_init__(self) -> None:
        self.state = State.at_rest(0, self.system.num_modes)
        self.largest_m = np.linalg.norm(self.system.shapes, axis=2).max(axis=0)

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves and nothing pushes."""
        return not (self.localities or self.constant or self.impulses)

    def push(self, force: ModalForce) -> None:
        """Let a force act from the next step on.

        Raises:
            ProblemError: too many groups move already.
        """
        if force.locality not in self.localities:
            if len(self.localities) >= MAX_GROUPS:
                raise ProblemError("validation-failed", f"{MAX_GROUPS} places still swing; push one of them, or wait")
            self.localities.append(force.locality)
            rest = np.zeros((1, self.system.num_modes), np.complex128)
            self.state = State(q=np.vstack([self.state.q, rest]), q_dot=np.vstack([self.state.q_dot, rest]))
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
        """One step of all groups at once; drop those that have settled."""
        self.frame += 1
        acceleration = np.zeros((1, *self.state.q.shape), np.complex128)
        for force in (*self.constant.values(), *self.impulses):
            acceleration[0, self.localities.index(force.locality)] += force.acceleration
        self.impulses.clear()
        _, self.state = run(self.step, self.state, acceleration)
        swing = np.abs(self.state.q) + np.abs(self.state.q_dot) / self.system.omega
        moving = swing @ self.largest_m >= SETTLED_M
        pushed = {force.locality for force in self.constant.values()}
        rows = [n for n, locality in enumerate(self.localities) if moving[n] or locality in pushed]
        if len(rows) < len(self.localities):
            self.localities = [self.localities[n] for n in rows]
            self.state = State(q=self.state.q[rows], q_dot=self.state.q_dot[rows])

    def next_frame(self) -> dict[str, object] | None:
        """The message of this frame, or None where the client has not acknowledged enough of the earlier ones."""
        if len(self.unacknowledged) >= WINDOW:
            self.skipped += 1
            return None
        self.unacknowledged.append(self.frame)
        q = with_bin_zero(self.state.q)  # [G, K, 2]
        groups = [{"locality": locality_payload(at), "q": q[n]} for n, at in enumerate(self.localities)]
        message = {"type": "frame", "frame": self.frame, "skipped": self.skipped, "groups": groups}
        self.skipped = 0
        return message
