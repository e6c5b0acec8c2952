"""/v1/interact/stream: a WebSocket for a drag that goes on. The client sends the pointer, the server coordinates.

Every message is a JSON object with a `type`. The client begins with

    open     spectrum_id, and as in /v1/interact: damping_ratio, mass_kg, locality, falloff_m; rate_hz (60)

and then sends, in any order,

    force    force: as in /v1/interact, without times. A drag or a wind replaces the one before and is held; an impulse
             is one knock
    release  kind: `drag` or `wind`, let go
    ack      frame: the highest frame that was drawn

The server sends

    opened   rate_hz, frequencies_hz, modal_mass_kg_m2
    frame    frame (its number, at frame / rate_hz seconds), skipped (frames left out before it), groups: locality and q
    rest     frame: everything has settled; nothing more is sent until the next force
    problem  code, detail, …: what was wrong with a message; the stream goes on, unless it was the first

The tree moves in real time whatever the line does. At most `WINDOW` frames are under way unacknowledged; further ones
are left out, so that a slow client sees fewer frames, not old ones.

Where a key is required, a page in a browser offers the protocols `dynamictree` and `bearer.KEY`; others send
Authorization.
"""

import asyncio
import logging
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
import orjson
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic import Field, TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool

from dynamictree.modal.force import generalised_force
from dynamictree.modal.locality import default_falloff_m
from dynamictree.modal.response import Locality, group_forces, with_bin_zero
from dynamictree.modal.step import State, Step, exact_step, run
from dynamictree.modal.system import DAMPING_RATIO, ModalSystem, with_physics
from service.http.problems import REFUSALS, ProblemError, Refusal, problem_body, problem_of
from service.http.validation_errors import field_errors, summed_up
from service.ready_tree import ReadyTree
from service.schemas.base import Finite, Payload
from service.schemas.forces import LARGEST, MAX_GROUPS, ForcePayload, library_force, locality_payload
from service.services import Owned, owned_by_caller
from service.tree_cache import ready_tree, with_mesh

router = APIRouter(prefix="/v1/interact")
logger = logging.getLogger(__name__)

WINDOW = 8  # frames under way: 130 ms at 60 Hz
OPEN_S = 10.0  # how long the first message may take
IDLE_S = 60.0  # after which a client that says nothing is let go
MAX_MESSAGE = 16_384  # characters
SETTLED_M = 1e-4  # no voxel moves further
LATE_S = 0.25  # after a longer stall the clock begins anew

INVALID, TOO_LARGE, DONE = 1008, 1009, 1000
PROTOCOL = "dynamictree"


class OpenMessage(Payload):
    """The first message."""

    type: Literal["open"]
    spectrum_id: str = Field(max_length=64)
    damping_ratio: Finite = Field(default=DAMPING_RATIO, ge=0, le=2)
    mass_kg: Finite | None = Field(default=None, gt=0, le=LARGEST)
    locality: Literal["none", "geodesic"] = "geodesic"
    falloff_m: Finite | None = Field(default=None, gt=0, le=LARGEST)
    rate_hz: Finite = Field(default=60.0, ge=1, le=120)


class ForceMessage(Payload):
    """Push, from now on."""

    type: Literal["force"]
    force: ForcePayload


class ReleaseMessage(Payload):
    """Let go."""

    type: Literal["release"]
    kind: Literal["drag", "wind"] = "drag"


class AckMessage(Payload):
    """What was drawn."""

    type: Literal["ack"]
    frame: int = Field(ge=0)


_FIRST = TypeAdapter(OpenMessage)
_Later = Annotated[ForceMessage | ReleaseMessage | AckMessage, Field(discriminator="type")]
_LATER: TypeAdapter[ForceMessage | ReleaseMessage | AckMessage] = TypeAdapter(_Later)


@dataclass
class Session:
    """One client's tree, as it swings."""

    system: ModalSystem
    step: Step
    falloff_m: float | None
    frame: int = 0
    under_way: deque[int] = field(default_factory=deque)  # frames that were sent and not acknowledged
    skipped: int = 0
    states: dict[Locality | None, State] = field(default_factory=dict)
    held: dict[str, tuple[Locality | None, np.ndarray]] = field(default_factory=dict)  # kind to acceleration [M]
    knocks: list[tuple[Locality | None, np.ndarray]] = field(default_factory=list)
    woken: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves and nothing pushes."""
        return not (self.states or self.held or self.knocks)

    def push(self, message: ForceMessage, ready: ReadyTree, owned: Owned, spectrum_id: str) -> None:
        """Take a force.

        Raises:
            InputError, ProblemError: it cannot be used.
        """
        if message.force.start_s != 0 or message.force.duration_s is not None:
            raise ProblemError("validation-failed", "forces of a stream begin now; leave start_s and duration_s out")
        force = library_force(message.force, self.system.grid, lambda: with_mesh(owned, ready, spectrum_id))
        pushed = generalised_force(self.system, force, dt_s=self.step.dt_s, num_frames=1)[0] / self.system.modal_mass
        locality = group_forces([force], falloff_m=self.falloff_m)[0].locality
        if locality not in self.states and len(self.states) >= MAX_GROUPS:
            raise ProblemError("validation-failed", f"{MAX_GROUPS} places still swing; push one of them, or wait")
        if message.force.kind == "impulse":
            self.knocks.append((locality, pushed))
        else:
            self.held[message.force.kind] = (locality, pushed)
        self.states.setdefault(locality, State.at_rest(1, self.system.num_modes))
        self.woken.set()

    def tick(self) -> None:
        """One step of everything."""
        self.frame += 1
        pushes = [*self.held.values(), *self.knocks]
        self.knocks = []
        for locality, state in list(self.states.items()):
            acceleration = np.zeros((1, 1, self.system.num_modes), np.complex128)
            for at, pushed in pushes:
                if at == locality:
                    acceleration[0, 0] += pushed
            _, moved = run(self.step, state, acceleration)
            self.states[locality] = moved
            if not any(at == locality for at, _ in self.held.values()) and self._settled(moved):
                del self.states[locality]

    def drawn(self, frame: int) -> None:
        """Take an acknowledgement of every frame up to this one."""
        while self.under_way and self.under_way[0] <= frame:
            self.under_way.popleft()

    def told(self) -> dict[str, object]:
        """The frame as it is sent."""
        groups = [
            {"locality": locality_payload(locality), "q": with_bin_zero(state.q[0])}
            for locality, state in self.states.items()
        ]
        return {"type": "frame", "frame": self.frame, "skipped": self.skipped, "groups": groups}

    def _settled(self, state: State) -> bool:
        """Whether no voxel can go further than `SETTLED_M` any more."""
        swing = np.abs(state.q[0]) + np.abs(state.q_dot[0]) / self.system.omega
        return bool((swing * self.largest_m).sum() < SETTLED_M)

    @property
    def largest_m(self) -> np.ndarray:
        """The largest displacement a unit of each coordinate, anywhere [m]."""
        if "_largest" not in self.__dict__:
            self.__dict__["_largest"] = np.linalg.norm(self.system.shapes, axis=2).max(axis=0)
        largest: np.ndarray = self.__dict__["_largest"]
        return largest


@router.websocket("/stream")
async def stream(socket: WebSocket) -> None:
    """Follow a pointer; see this module's docstring."""
    # a browser insists that one of the protocols that it offers is taken; the other one is its key
    await socket.accept(PROTOCOL if PROTOCOL in socket.scope["subprotocols"] else None)
    owned = await owned_by_caller(socket)
    try:
        opened = await _open(socket, owned)
        if opened is None:
            return
        message, ready, session = opened
        async with asyncio.TaskGroup() as tasks:
            ticking = tasks.create_task(_send_frames(socket, session))
            await _receive(socket, owned, message.spectrum_id, ready, session)
            ticking.cancel()
    except* WebSocketDisconnect:
        logger.debug("the client has gone")


async def _open(socket: WebSocket, owned: Owned) -> tuple[OpenMessage, ReadyTree, Session] | None:
    """Answer the first message; None where it was refused."""
    try:
        message = _FIRST.validate_json(await asyncio.wait_for(_text(socket), OPEN_S))
        ready = await run_in_threadpool(ready_tree, owned, message.spectrum_id)
        system = with_physics(ready.tree.system, mass_kg=message.mass_kg, damping_ratio=message.damping_ratio)
    except TimeoutError:
        await socket.close(INVALID, f"no open message within {OPEN_S:g} s")
        return None
    except (ValidationError, *REFUSALS) as error:
        await _send(socket, _problem(error))
        await socket.close(INVALID)
        return None
    falloff = None if message.locality == "none" else message.falloff_m or default_falloff_m(system)
    session = Session(system=system, step=exact_step(system, 1 / message.rate_hz), falloff_m=falloff)
    frequencies = [0.0, *(system.omega / (2 * np.pi)).tolist()]
    await _send(
        socket,
        {
            "type": "opened",
            "rate_hz": message.rate_hz,
            "frequencies_hz": frequencies,
            "modal_mass_kg_m2": system.modal_mass,
        },
    )
    return message, ready, session


async def _receive(socket: WebSocket, owned: Owned, spectrum_id: str, ready: ReadyTree, session: Session) -> None:
    """Take messages until the client goes or falls silent."""
    while True:
        try:
            message = _LATER.validate_json(await asyncio.wait_for(_text(socket), IDLE_S))
            if isinstance(message, ForceMessage):
                await run_in_threadpool(session.push, message, ready, owned, spectrum_id)
            elif isinstance(message, ReleaseMessage):
                session.held.pop(message.kind, None)
            else:
                session.drawn(message.frame)
        except TimeoutError:
            await socket.close(DONE, f"nothing was heard for {IDLE_S:g} s")
            return
        except (ValidationError, *REFUSALS) as error:
            await _send(socket, _problem(error))


async def _send_frames(socket: WebSocket, session: Session) -> None:
    """Move the tree in real time, and send what the client keeps up with."""
    due = time.monotonic()
    while True:
        if session.at_rest:
            if session.frame:
                await _send(socket, {"type": "rest", "frame": session.frame})
            session.woken.clear()
            await session.woken.wait()
            due = time.monotonic()
        session.tick()
        if len(session.under_way) < WINDOW:
            session.under_way.append(session.frame)
            await _send(socket, session.told())
            session.skipped = 0
        else:
            session.skipped += 1
        due += session.step.dt_s
        if time.monotonic() - due > LATE_S:
            due = time.monotonic()
        await asyncio.sleep(max(0.0, due - time.monotonic()))


async def _text(socket: WebSocket) -> str:
    text = await socket.receive_text()
    if len(text) > MAX_MESSAGE:
        await socket.close(TOO_LARGE, f"messages have at most {MAX_MESSAGE:,} characters")
        raise WebSocketDisconnect(TOO_LARGE)
    return text


async def _send(socket: WebSocket, message: dict[str, object]) -> None:
    await socket.send_text(orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY).decode())


def _problem(error: ValidationError | Refusal) -> dict[str, object]:
    """A problem object, less its `type`, whose place the message's own takes."""
    if isinstance(error, ValidationError):
        located = [{**item, "loc": ("body", *item["loc"])} for item in error.errors()]
        error = ProblemError("validation-failed", summed_up(field_errors(located)))
    told = problem_of(error)
    return problem_body(told.code, told.detail, request_id=None) | {"type": "problem"}
