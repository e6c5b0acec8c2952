"""Bodies of /v1/interact, and their conversion to the library's types. Metres, newtons, seconds; +Z up."""

from collections.abc import Callable, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, WithJsonSchema, model_validator

from dynamictree.modal.force import Contact, Drag, Force, Impulse, WindField, contact_at_point, contact_at_voxel
from dynamictree.modal.interactive_tree import ForceGroup, Locality, Reached
from dynamictree.modal.local_bend import Bend
from dynamictree.modal.response import Start, with_bin_zero
from dynamictree.modal.step import State
from dynamictree.request_model import LARGEST
from dynamictree.requests import MAX_FRAMES, InteractParams
from dynamictree.voxel.grid import VoxelGrid
from service.http.problems import ProblemError
from service.schemas.base import Finite, Payload

MAX_FORCES = 32
MAX_GROUPS = 64
MAX_WIND_SAMPLES = 600
CLOSE_SHARE = 0.01  # share of the pull; a smaller error counts as reached
MAX_BENDS = 1024  # joints per group

Component = Annotated[Finite, Field(ge=-LARGEST, le=LARGEST)]
Vector = tuple[Component, Component, Component]
Complex = Annotated[tuple[Component, Component], Field(description="Real and imaginary part")]
_NUMBER = {"type": "number"}
_EACH = {"anyOf": [_NUMBER, {"type": "array", "items": _NUMBER, "minItems": 3, "maxItems": 3}]}
Winds = Annotated[
    Vector | Annotated[list[Vector], Field(min_length=1, max_length=MAX_WIND_SAMPLES)],
    # a single array schema: for two, C# generators emit two methods of one name
    WithJsonSchema({"type": "array", "items": _EACH, "minItems": 1, "maxItems": MAX_WIND_SAMPLES}),
]
Output = Literal["modal", "voxels", "vertices", "gaussians"]

_VECTORS = {"impulse": ("impulse_n_s",), "drag": ("force_n", "displacement_m"), "wind": ("wind_m_s",)}


class AtPayload(Payload):
    """Place of a force: exactly one of point, vertex and voxel."""

    point_m: Vector | None = Field(default=None, description="Point; the nearest voxel is used [m]")
    vertex: int | None = Field(default=None, ge=0, description="Index of a vertex of the source mesh")
    voxel: int | None = Field(default=None, ge=0, description="Row of a voxel in the spectrum's coords")
    radius_m: Finite = Field(default=0.0, ge=0, le=1e3, description="Radius over which the force is spread [m]")

    @model_validator(mode="after")
    def _one_place(self) -> "AtPayload":
        given = [name for name in ("point_m", "vertex", "voxel") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of point_m, vertex and voxel, not {len(given)}")
        return self


class ForcePayload(Payload):
    """One force on the tree."""

    kind: Literal["impulse", "drag", "wind"]
    at: AtPayload | None = Field(default=None, description="Place of an impulse or a drag; wind acts everywhere")
    impulse_n_s: Vector | None = Field(default=None, description="Impulse [N s]; only with kind impulse")
    force_n: Vector | None = Field(default=None, description="Force of a drag [N]; alternative to displacement_m")
    displacement_m: Vector | None = Field(default=None, description="Displacement of the dragged point at rest [m]")
    wind_m_s: Winds | None = Field(
        default=None, description="Velocity of wind [m/s]: one vector, or evenly spaced samples over the duration"
    )
    start_s: Finite = Field(default=0.0, ge=-1e6, le=1e6, description="Start, relative to this call's first frame [s]")
    duration_s: Finite | None = Field(
        default=None, ge=0, le=1e6, description="Duration [s]; if unset, one step for an impulse, else until the end"
    )

    @model_validator(mode="after")
    def _its_own_vector(self) -> "ForcePayload":
        allowed = _VECTORS[self.kind]
        every = [name for names in _VECTORS.values() for name in names]
        given = [name for name in every if getattr(self, name) is not None]
        if len(given) != 1 or given[0] not in allowed:
            raise ValueError(
                f"{self.kind} takes exactly one of {', '.join(allowed)}; given: {', '.join(given) or 'none'}"
            )
        if (self.at is None) != (self.kind == "wind"):
            raise ValueError("impulse and drag need at, the place where they act; wind takes none")
        return self


class LocalityPayload(Payload):
    """Centre of a group's response, and the length over which it fades."""

    seed_voxel: int = Field(ge=0)
    falloff_m: Finite = Field(gt=0, le=LARGEST)


class GroupStatePayload(Payload):
    """One group's coordinates: K complex numbers, index = frequency bin; bin 0 is no mode and stays 0."""

    locality: LocalityPayload | None = Field(description="Locality of the group; null is the whole tree")
    q: list[Complex] = Field(max_length=4096)
    q_dot: list[Complex] = Field(max_length=4096, description="Rates of q [1/s]")
    bend: list[Vector] | None = Field(
        default=None, max_length=MAX_BENDS, description="Local bends [rad], from the grip's joint towards the root"
    )
    bend_rate: list[Vector] | None = Field(default=None, max_length=MAX_BENDS, description="Rates of bend [rad/s]")


class StatePayload(Payload):
    """State at the end of one call, from which the next call continues."""

    groups: list[GroupStatePayload] = Field(max_length=MAX_GROUPS)


class InteractRequest(InteractParams):
    """Forces on a tree, and the response to compute."""

    spectrum_id: str = Field(max_length=64, description="The spectrum_id in a job's result")
    forces: list[ForcePayload] = Field(default_factory=list, max_length=MAX_FORCES)
    dt_s: Finite = Field(default=1 / 60, ge=1e-6, le=10, description="Time step, which is also the time of a frame [s]")
    num_frames: int = Field(default=60, ge=1, le=MAX_FRAMES)
    start: Start = Field(
        default="rest", description="Start without initial_state: at rest, in equilibrium (held), or after Davis et al."
    )
    initial_state: StatePayload | None = Field(default=None, description="The final_state of an earlier call")
    output: Output = "modal"
    warp: Annotated[Literal[True], WithJsonSchema({"type": "boolean"})] | None = Field(
        default=None, deprecated=True, description="Without effect, and never false: the tree always bends"
    )


def library_force(force: ForcePayload, grid: VoxelGrid, vertex_contact: Callable[[int, float], Contact]) -> Force:
    """Convert to the library's force; `vertex_contact` returns the contact at a vertex, within a radius [m]."""
    if force.wind_m_s is not None:
        samples = force.wind_m_s if isinstance(force.wind_m_s, list) else [force.wind_m_s]
        return WindField(velocity_m_s=np.array(samples), start_s=force.start_s, duration_s=force.duration_s)
    assert force.at is not None
    at = _contact(force.at, grid, vertex_contact)
    if force.impulse_n_s is not None:
        return Impulse(at=at, impulse_n_s=force.impulse_n_s, start_s=force.start_s, duration_s=force.duration_s or 0.0)
    return Drag(
        at=at,
        force_n=force.force_n,
        displacement_m=force.displacement_m,
        start_s=force.start_s,
        duration_s=force.duration_s,
    )


def with_state(
    groups: tuple[ForceGroup, ...], state: StatePayload, num_modes: int
) -> tuple[tuple[ForceGroup, ...], State, tuple[Bend, ...]]:
    """Return all groups, of the forces and of the earlier state, with their initial state and bends."""
    by_locality = {_locality(group.locality): group for group in state.groups}
    if len(by_locality) != len(state.groups):
        raise ProblemError("validation-failed", "/initial_state/groups: two groups have the same locality")
    forced = {group.locality for group in groups}
    groups += tuple(ForceGroup(locality=locality) for locality in by_locality if locality not in forced)
    rows = [_coordinates(by_locality.get(group.locality), num_modes) for group in groups]
    stacked = np.stack(rows) if rows else np.zeros((0, 2, num_modes), np.complex128)
    bends = tuple(_bend(by_locality.get(group.locality)) for group in groups)
    return groups, State(q=stacked[:, 0], q_dot=stacked[:, 1]), bends


def state_payload(groups: tuple[ForceGroup, ...], state: State, bends: Sequence[Bend]) -> dict[str, object]:
    """Return the state as a response body, which a `StatePayload` can read."""
    return {
        "groups": [
            {"locality": group.locality, "q": with_bin_zero(q), "q_dot": with_bin_zero(q_dot)}
            | ({"bend": bend.turn, "bend_rate": bend.rate} if len(bend.turn) else {"bend": None, "bend_rate": None})
            for group, q, q_dot, bend in zip(groups, state.q, state.q_dot, bends, strict=True)
        ]
    }


def reached_payload(reached: Reached) -> dict[str, object]:
    """Return how far a drag reaches, as a response body."""
    error = float(np.linalg.norm(reached.wanted_m - reached.reached_m))
    short = error > CLOSE_SHARE * float(np.linalg.norm(reached.wanted_m))
    return {
        "wanted_m": reached.wanted_m.tolist(),
        "reached_m": reached.reached_m.tolist(),
        "error_m": error,
        "why": reached.why if short else None,
    }


def _contact(at: AtPayload, grid: VoxelGrid, vertex_contact: Callable[[int, float], Contact]) -> Contact:
    if at.voxel is not None:
        contact = contact_at_voxel(grid, at.voxel)
        if at.radius_m == 0:
            return contact
        centre = grid.centres_m[at.voxel].tolist()
        return contact_at_point(grid, (centre[0], centre[1], centre[2]), radius_m=at.radius_m)
    if at.point_m is not None:
        return contact_at_point(grid, at.point_m, radius_m=at.radius_m)
    assert at.vertex is not None
    return vertex_contact(at.vertex, at.radius_m)


def _locality(payload: LocalityPayload | None) -> Locality | None:
    return None if payload is None else Locality(seed_voxel=payload.seed_voxel, falloff_m=payload.falloff_m)


def _bend(group: GroupStatePayload | None) -> Bend:
    """Return the bends of a group; straight if the group is new."""
    if group is None or not group.bend:
        return Bend.straight()
    rate = group.bend_rate or [(0.0, 0.0, 0.0)] * len(group.bend)
    if len(rate) != len(group.bend) or group.locality is None:
        detail = f"bend has {len(group.bend)} joints and bend_rate {len(rate)}; give as many, and a locality"
        raise ProblemError("validation-failed", f"/initial_state/groups: {detail}")
    return Bend(turn=np.array(group.bend), rate=np.array(rate))


def _coordinates(group: GroupStatePayload | None, num_modes: int) -> np.ndarray:
    """Return q and q̇ without bin 0 [2, M]; zero if the group is new."""
    if group is None:
        return np.zeros((2, num_modes), np.complex128)
    for name, values in (("q", group.q), ("q_dot", group.q_dot)):
        if len(values) != num_modes + 1:
            detail = f"{name} has {len(values)} numbers; this spectrum has {num_modes + 1} bins"
            raise ProblemError("validation-failed", f"/initial_state/groups: {detail}")
    state_values = np.array([group.q, group.q_dot])  # [2, K, 2]
    return np.asarray(state_values[:, 1:, 0] + 1j * state_values[:, 1:, 1])
