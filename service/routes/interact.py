"""/v1/interact: apply forces to a tree. Stateless: the state is part of request and answer."""

import asyncio
import json
import logging
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Annotated

import numpy as np
import orjson
from fastapi import APIRouter, Header, Request
from fastapi.responses import Response
from jaxtyping import Float32
from pydantic import Field
from safetensors.numpy import save
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from dynamictree.errors import Cancelled, UnstableTimestep
from dynamictree.modal.interactive_tree import Answer
from dynamictree.modal.local_bend import Bend
from dynamictree.modal.response import Start, answer_tensors, group_forces, respond, with_bin_zero
from dynamictree.modal.step import State
from dynamictree.modal.system import ModalSystem, chosen_falloff_m
from service.http.problems import ProblemError
from service.http.request_headers import JSON, SAFETENSORS, preferred_media_type
from service.http.routing import refusals
from service.interact.forces import (
    MAX_GROUPS,
    Complex,
    InteractRequest,
    LocalityPayload,
    Output,
    StatePayload,
    Vector,
    library_force,
    reached_payload,
    state_payload,
    with_state,
)
from service.interact.tree_cache import ServedTree, living_tree, served_tree, system_facts
from service.schemas.base import Payload
from service.services import Owned, OwnedDep

router = APIRouter(prefix="/v1/interact", tags=["interact"])
logger = logging.getLogger(__name__)

MAX_DISPLACEMENT_BYTES = 128 * 1024**2
"""Size of one response in voxels, vertices or Gaussians: 110 frames of 100,000 vertices, 33 of 100,000 Gaussians."""

MAX_WORK = 60_000_000
"""Groups x frames x points of one response. With 10,680 voxels and 1,376 bones one took 49 ns of CPU time at 64 groups
and 78 ns at 8, so this limit is 3 to 5 s."""

SLOT_WAIT_S = 30.0
SEND_S = 120.0
PIECE_BYTES = 256 * 1024
"""A large response waits `SLOT_WAIT_S` for its slot and occupies it for at most `SEND_S`."""

MAX_QUICK = 256
"""Frames x groups up to which the event loop computes the response itself; larger ones are computed in a thread."""


class GroupPayload(Payload):
    """One group's modal coordinates."""

    locality: LocalityPayload | None = Field(description="Locality of the group; null is the whole tree")
    q: list[list[Complex]] = Field(description="Coordinates [frames, K] by frequency bin; bin 0 is always 0")
    bend: list[list[Vector]] | None = Field(
        description="Bends of joints from the grip towards the root, [frames, n] vectors [rad]; null if none bends"
    )


class ReachedPayload(Payload):
    """Result of a drag by displacement, which falls short where the tree would have to stretch."""

    wanted_m: Vector
    reached_m: Vector = Field(description="Displacement of the point in the bent shape [m]")
    error_m: float
    why: str | None = Field(description="Reason for a shortfall; null if below 1 % of the pull")


class InteractPayload(Payload):
    """Modal coordinates. With φ_k = 2c_k of the spectrum, u(p) = Σ_g w_g(p) Re Σ_k φ_k(p) q_{g,k}."""

    spectrum_id: str
    output: Output
    integrator: str
    dt_s: float
    num_frames: int
    frequencies_hz: list[float] = Field(description="Natural frequencies by bin [Hz]; bin 0 is always 0")
    damping_ratio: float
    foliage: float | None = Field(
        description="Foliage, which sets damping and frequency, 0 (bare) to 1 (in leaf); null if neither request nor "
        "shape states it, and the middle is used"
    )
    mass_kg: float
    modal_mass_kg_m2: float = Field(description="m in m (q̈ + 2ζω q̇ + ω² q) = Σ conj(φ)·F")
    groups: list[GroupPayload]
    reached: list[ReachedPayload] = Field(description="Result of each drag by displacement, by group")
    final_state: StatePayload = Field(description="The initial_state of the next call")


@router.post(
    "",
    response_model=InteractPayload,
    responses=refusals("not-found", "not-acceptable", "expired", "unstable-timestep", "overloaded")
    | {
        200: {
            "description": "Modal coordinates; other outputs only as safetensors (see docs/interaction.md)",
            "content": {SAFETENSORS: {"schema": {"type": "string", "format": "binary"}}},
        }
    },
)
async def interact(
    request: Request, body: InteractRequest, owned: OwnedDep, accept: Annotated[str | None, Header()] = None
) -> Response:
    """Apply forces to a tree, and return its response."""
    offered = (JSON, SAFETENSORS) if body.output == "modal" else (SAFETENSORS,)
    media_type = preferred_media_type(accept, offered)
    tree = living_tree(owned, body.spectrum_id)
    if tree is not None and _is_quick(body):
        return _response(body, tree, media_type, threading.Event())  # takes 1 to 3 ms; a thread would double it
    if body.output == "modal":
        return await run_in_threadpool(_prepared_response, body, owned, media_type, threading.Event())
    async with AsyncExitStack() as large_slot:
        try:
            async with asyncio.timeout(SLOT_WAIT_S):
                await large_slot.enter_async_context(owned.services.large_answers.slot(owned.caller.owner or ""))
        except TimeoutError as error:
            raise ProblemError("overloaded", "other large answers are computed or sent; try again") from error
        try:
            async with _disconnect_event(request) as left:
                response = await run_in_threadpool(_prepared_response, body, owned, media_type, left)
        except Cancelled:
            return Response(status_code=CLIENT_LEFT)
        return SlotResponse(response, large_slot.pop_all())


CLIENT_LEFT = 499
"""nginx's status for a client that has disconnected; it appears only in the log."""


@asynccontextmanager
async def _disconnect_event(request: Request) -> AsyncIterator[threading.Event]:
    """Context manager that yields an event, which is set once the client has closed the connection."""
    left = threading.Event()

    async def watch() -> None:
        while (await request.receive())["type"] != "http.disconnect":
            pass
        left.set()

    watching = asyncio.create_task(watch())
    try:
        yield left
    finally:
        watching.cancel()


class SlotResponse(Response):
    """Large response that is sent in pieces, as the client reads, and releases its slot at the end."""

    def __init__(self, response: Response, large_slot: AsyncExitStack) -> None:
        super().__init__(response.body, response.status_code, None, response.media_type)
        self.large_slot = large_slot

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response, or give up after `SEND_S`."""
        start = {"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers}
        content = memoryview(self.body)
        async with self.large_slot:
            try:
                async with asyncio.timeout(SEND_S):
                    await send(start)
                    for at in range(0, len(content), PIECE_BYTES):
                        piece = bytes(content[at : at + PIECE_BYTES])
                        more = at + PIECE_BYTES < len(content)
                        await send({"type": "http.response.body", "body": piece, "more_body": more})
            except TimeoutError:
                logger.info("a large answer was not read within %g s", SEND_S)


def _is_quick(body: InteractRequest) -> bool:
    """Return whether a response takes a few milliseconds and reads no files."""
    at_vertices = any(force.at is not None and force.at.vertex is not None for force in body.forces)
    groups = len(body.forces) + (0 if body.initial_state is None else len(body.initial_state.groups))
    small = body.num_frames * max(groups, 1) <= MAX_QUICK
    return body.output == "modal" and not (at_vertices or _bends_joints(body)) and small


def _bends_joints(body: InteractRequest) -> bool:
    """Return whether a response needs the rig, whose joints drags by displacement bend."""
    before = [] if body.initial_state is None else body.initial_state.groups
    return any(force.displacement_m for force in body.forces) or any(group.bend for group in before)


def _prepared_response(body: InteractRequest, owned: Owned, media_type: str, left: threading.Event) -> Response:
    try:
        return _response(body, served_tree(owned, body.spectrum_id), media_type, left)
    finally:
        owned.services.trees.trim()  # the cached tree may have grown for this response


def _response(body: InteractRequest, tree: ServedTree, media_type: str, left: threading.Event) -> Response:
    system, answer = compute_response(body, tree)
    if media_type == JSON:
        return Response(
            orjson.dumps(_interact_payload(body, system, answer), option=orjson.OPT_SERIALIZE_NUMPY), 200, None, JSON
        )
    arrays = answer_tensors(answer)
    if body.output == "gaussians":
        arrays |= _gaussians(body, tree, answer, left)
    elif body.output != "modal":
        arrays["displacement"] = _displacement(body, tree, answer, left)
    facts = {n: fact if isinstance(fact, str) else json.dumps(fact) for n, fact in _facts(body, system).items()}
    packed = save({name: np.ascontiguousarray(array) for name, array in arrays.items()}, facts)
    return Response(packed, 200, None, media_type)


def compute_response(body: InteractRequest, tree: ServedTree) -> tuple[ModalSystem, Answer]:
    """Compute the tree's response to a request."""
    system = tree.system(body)
    forces = [library_force(force, system.grid, tree.vertex_contact) for force in body.forces]
    groups = group_forces(forces, falloff_m=chosen_falloff_m(system, body))
    begin: Start | State = body.start
    bends: tuple[Bend, ...] = ()
    if body.initial_state is not None:
        groups, begin, bends = with_state(groups, body.initial_state, system.num_modes)
    if len(groups) > MAX_GROUPS:
        raise ProblemError("validation-failed", f"{len(groups)} groups of forces; at most {MAX_GROUPS} are allowed")
    try:
        answer = respond(
            system,
            groups,
            dt_s=body.dt_s,
            num_frames=body.num_frames,
            integrator=body.integrator,
            start=begin,
            start_bends=bends,
            tree=tree.with_rig() if _bends_joints(body) else None,
        )
    except UnstableTimestep as error:
        raise ProblemError(error.code, str(error), extra={"max_dt_s": error.max_dt_s}) from error
    return system, answer


def _displacement(body: InteractRequest, tree: ServedTree, answer: Answer, left: threading.Event) -> np.ndarray:
    """Return the displacement of voxels or vertices, [T, V or N, 3] [m]."""
    if body.output == "voxels":
        _refuse_costly(answer, len(tree.ready.tree.system.grid), 12)
        return np.stack(list(_until_disconnected(tree.with_rig().voxels(answer), left)))
    _refuse_costly(answer, tree.mesh().num_vertices, 12)
    return np.stack(list(_until_disconnected(_iter_vertices(tree, answer), left)))


def _until_disconnected(frames: Iterator[np.ndarray], left: threading.Event) -> Iterator[np.ndarray]:
    """Iterate over frames until the client has disconnected.

    Raises:
        Cancelled: the client has disconnected.
    """
    for frame in frames:
        if left.is_set():
            raise Cancelled("the client has left")
        yield frame


def _iter_vertices(tree: ServedTree, answer: Answer) -> Iterator[Float32[np.ndarray, "N 3"]]:
    """Iterate over the displacement of the mesh's vertices in each frame [m]."""
    return tree.with_rig().bent(answer, tree.mesh().vertices, tree.rig().vertices)


def _gaussians(body: InteractRequest, tree: ServedTree, answer: Answer, left: threading.Event) -> dict[str, np.ndarray]:
    """Return the moving Gaussians: `rows` [M] in the cloud, `means`, `quaternions`, `scales` [T, M, 3 or 4]."""
    from dynamictree.gaussian.deform import Pose  # imports numba

    moving = tree.gaussians()
    _refuse_costly(answer, len(moving.rows), 40)
    shape = body.num_frames, len(moving.rows)
    means, quaternions, scales = (np.empty((*shape, width), np.float32) for width in (3, 4, 3))
    with moving.alone:
        for frame, vertices in enumerate(_until_disconnected(_iter_vertices(tree, answer), left)):
            out = Pose(means=means[frame], quaternions=quaternions[frame], scales=scales[frame])
            moving.deformer.pose(vertices, out=out)
    return {"rows": moving.rows, "means": means, "quaternions": quaternions, "scales": scales}


def _refuse_costly(answer: Answer, num_points: int, bytes_a_point: int) -> None:
    num_frames, num_groups = answer.q.shape[:2]
    wanted = bytes_a_point * num_frames * num_points
    if num_frames * num_groups * num_points > MAX_WORK:
        fits, costs = MAX_WORK // (max(num_groups, 1) * num_points), f"moved by {num_groups} groups take too long"
    elif wanted > MAX_DISPLACEMENT_BYTES:
        fits = MAX_DISPLACEMENT_BYTES // (bytes_a_point * num_points)
        costs = f"are {wanted:,} bytes, {MAX_DISPLACEMENT_BYTES:,} are allowed"
    else:
        return
    detail = f"{num_frames} frames of {num_points:,} points {costs}; ask for {fits} frames at a time, or for modal"
    raise ProblemError("validation-failed", detail)


def _facts(body: InteractRequest, system: ModalSystem) -> dict[str, object]:
    return {
        "spectrum_id": body.spectrum_id,
        "output": body.output,
        "integrator": body.integrator,
        "dt_s": body.dt_s,
        "num_frames": body.num_frames,
        "mass_kg": system.mass_kg,
        **system_facts(system),
    }


def _interact_payload(body: InteractRequest, system: ModalSystem, answer: Answer) -> dict[str, object]:
    coordinates = with_bin_zero(answer.q)  # [T, G, K, 2]
    groups = [
        {
            "locality": group.locality,
            "q": np.ascontiguousarray(coordinates[:, index]),
            "bend": answer.bends[index] if answer.bends[index].shape[1] else None,
        }
        for index, group in enumerate(answer.groups)
    ]
    reached = [reached_payload(place) for place in answer.reached]
    final = state_payload(answer.groups, answer.final, answer.final_bends)
    return _facts(body, system) | {"groups": groups, "reached": reached, "final_state": final}
