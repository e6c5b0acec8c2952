"""/v1/interact/stream: a WebSocket for a continuous drag. The client sends the pointer, the server coordinates.

docs/interaction.md describes the messages. The tree moves in real time at any connection speed: at most `WINDOW`
frames are unacknowledged and further ones are skipped, so that a slow client sees fewer frames, not old ones.
"""

import asyncio
import logging
import time
from functools import partial
from typing import Annotated, Literal

import orjson
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic import Field, TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocketState

from dynamictree.modal.step import exact_step
from dynamictree.modal.system import chosen_falloff_m
from dynamictree.requests import SwingParams
from service.http.problems import REFUSALS, ProblemError, Refusal, problem_body, problem_of
from service.http.slots import until_revoked
from service.http.validation_errors import invalid_fields
from service.interact.forces import ForcePayload
from service.interact.session import Grips, Session, force_of
from service.interact.tree_cache import ServedTree, served_tree, system_facts
from service.schemas.base import Finite, Payload
from service.services import Owned, owned_by_caller

router = APIRouter(prefix="/v1/interact")
logger = logging.getLogger(__name__)

OPEN_S = 10.0  # timeout for the first message
IDLE_S = 60.0  # a client that sends nothing for so long is disconnected
MAX_MESSAGE = 16_384  # characters
MAX_LAG_S = 0.25  # the clock restarts if a stall was longer than this

INVALID, TOO_LARGE, DONE, BUSY, UNSUPPORTED = 1008, 1009, 1000, 1013, 1003
PROTOCOL = "dynamictree"


class OpenMessage(SwingParams):
    """First message of a stream: the tree and its physics."""

    type: Literal["open"]
    spectrum_id: str = Field(max_length=64)
    rate_hz: Finite = Field(default=60.0, ge=1, le=120)


class ForceMessage(Payload):
    """Message that applies a force from now on."""

    type: Literal["force"]
    force: ForcePayload


class ReleaseMessage(Payload):
    """Message that ends a drag or the wind."""

    type: Literal["release"]
    kind: Literal["drag", "wind"] = "drag"


class AckMessage(Payload):
    """Message that acknowledges drawn frames."""

    type: Literal["ack"]
    frame: int = Field(ge=0)


_FIRST = TypeAdapter(OpenMessage)
_Later = Annotated[ForceMessage | ReleaseMessage | AckMessage, Field(discriminator="type")]
_LATER: TypeAdapter[ForceMessage | ReleaseMessage | AckMessage] = TypeAdapter(_Later)


@router.websocket("/stream")
async def stream(socket: WebSocket) -> None:
    """Stream the motion of a tree while the client pushes and drags it."""
    # a browser requires that the server selects one of the offered protocols; the other one holds its key
    await socket.accept(PROTOCOL if PROTOCOL in socket.scope["subprotocols"] else None)
    owned = await owned_by_caller(socket)
    try:
        with owned.services.streams.opened(owned.caller):
            await _serve(socket, owned)
    except ProblemError as error:
        await _send(socket, _problem(error))
        await socket.close(BUSY)


async def _serve(socket: WebSocket, owned: Owned) -> None:
    try:
        opened = await _open(socket, owned)
        if opened is None:
            return
        message, tree, session = opened
        async with asyncio.TaskGroup() as tasks:
            ticking = tasks.create_task(_send_frames(socket, session))
            watching = tasks.create_task(_close_once_revoked(socket, owned))
            await _receive(socket, message, tree, session)
            ticking.cancel()
            watching.cancel()
    except* WebSocketDisconnect:
        logger.debug("the client disconnected")


async def _close_once_revoked(socket: WebSocket, owned: Owned) -> None:
    await until_revoked(owned.services.store, owned.caller)
    await socket.close(INVALID, "the key was revoked or has expired")
    raise WebSocketDisconnect(INVALID)


async def _open(socket: WebSocket, owned: Owned) -> tuple[OpenMessage, ServedTree, Session] | None:
    """Answer the first message; return None if it was refused."""
    try:
        message = _FIRST.validate_json(await asyncio.wait_for(_text(socket), OPEN_S))
        tree = await run_in_threadpool(served_tree, owned, message.spectrum_id)
        system = tree.system(message)
    except TimeoutError:
        await socket.close(INVALID, f"no open message within {OPEN_S:g} s")
        return None
    except (ValidationError, *REFUSALS) as error:
        await _send(socket, _problem(error))
        await socket.close(INVALID)
        return None
    session = Session(system=system, step=exact_step(system, 1 / message.rate_hz))
    await _send(socket, {"type": "opened", "rate_hz": message.rate_hz, **system_facts(system)})
    return message, tree, session


async def _receive(socket: WebSocket, opened: OpenMessage, tree: ServedTree, session: Session) -> None:
    """Receive messages until the client disconnects or is idle for too long."""
    project = partial(
        force_of,
        system=session.system,
        dt_s=session.step.dt_s,
        falloff_m=chosen_falloff_m(session.system, opened),
        vertex_contact=tree.vertex_contact,
        grips=Grips(tree.with_rig, session.system),
    )
    while True:
        try:
            message = _LATER.validate_json(await asyncio.wait_for(_text(socket), IDLE_S))
            if isinstance(message, ForceMessage):
                session.push(await run_in_threadpool(project, message.force))
            elif isinstance(message, ReleaseMessage):
                session.release(message.kind)
            else:
                session.acknowledge(message.frame)
        except TimeoutError:
            await socket.close(DONE, f"nothing was heard for {IDLE_S:g} s")
            return
        except (ValidationError, *REFUSALS) as error:
            await _send(socket, _problem(error))


async def _send_frames(socket: WebSocket, session: Session) -> None:
    """Move the tree in real time, and send the frames that the client keeps up with."""
    due = time.monotonic()
    while True:
        if session.at_rest:
            if session.frame:
                await _send(socket, {"type": "rest", "frame": session.frame})
            session.woken.clear()
            if session.at_rest:  # a force may have come while the message was sent
                await session.woken.wait()
            due = time.monotonic()
        session.tick()
        message = session.next_frame()
        if message is not None:
            await _send(socket, message)
        due += session.step.dt_s
        if time.monotonic() - due > MAX_LAG_S:
            due = time.monotonic()
        await asyncio.sleep(max(0.0, due - time.monotonic()))


async def _text(socket: WebSocket) -> str:
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", DONE))
    text: str | None = message.get("text")
    if text is None:
        await socket.close(UNSUPPORTED, "messages are text: one JSON object each")
        raise WebSocketDisconnect(UNSUPPORTED)
    if len(text) > MAX_MESSAGE:
        await socket.close(TOO_LARGE, f"messages have at most {MAX_MESSAGE:,} characters")
        raise WebSocketDisconnect(TOO_LARGE)
    return text


async def _send(socket: WebSocket, message: dict[str, object]) -> None:
    if socket.application_state == WebSocketState.DISCONNECTED:  # closed by another task of this stream
        raise WebSocketDisconnect(DONE)
    await socket.send_text(orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY).decode())


def _problem(error: ValidationError | Refusal) -> dict[str, object]:
    """Return a problem object in which `type` is that of the message."""
    if isinstance(error, ValidationError):
        error = invalid_fields(error.errors(), "body")
    problem = problem_of(error)
    return problem_body(problem.code, problem.detail, request_id=None) | {"type": "problem"}
