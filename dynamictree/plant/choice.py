"""Choose the moving parts of a mesh, splat or scan: those detected, changed by the request's names and boxes."""

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import in_box
from dynamictree.mesh import TriangleMesh
from dynamictree.request_model import Box
from dynamictree.requests import CloudParams

MOST_LISTED = 50
"""Number of part names in the summary of a mesh."""


def with_choice(mesh: TriangleMesh, choice: CloudParams) -> TriangleMesh:
    """Change the still faces of a mesh by a request; faces that the request does not name stay as detected.

    Raises:
        InputError: a name or box matches nothing, or no face is left to move.
    """
    materials, parts = _names(mesh)
    nothing = np.full(mesh.num_faces, -1)
    owners = [nothing if owner is None else owner for owner in (mesh.look.face_material, mesh.parts.of_face)]
    middles = mesh.vertices[mesh.faces].mean(axis=1, dtype=np.float32)
    moving = np.ones(mesh.num_faces, np.bool_) if mesh.still_faces is None else ~mesh.still_faces
    moving = _apply_request(moving, middles, ((materials, owners[0]), (parts, owners[1])), choice)
    if not moving.any():
        raise InputError("still, still_box_m and box_m leave no face that moves; take something out of them")
    return replace(mesh, still_faces=None if moving.all() else ~moving)


def choose_gaussians(
    means: Float32[np.ndarray, "G 3"],
    may_move: Bool[np.ndarray, " G"],
    parts: Sequence[str],
    part_of: UInt8[np.ndarray, " G"] | None,
    choice: CloudParams,
) -> Bool[np.ndarray, " G"]:
    """Return a mask of the moving Gaussians: `may_move`, changed by the request's names of parts and boxes.

    Raises:
        InputError: a name or box matches nothing, or no Gaussian is left to move.
    """
    number = np.full(len(means), -1) if part_of is None else part_of.astype(np.int64) - 1
    moving = _apply_request(may_move, means, ((parts, number),), choice)
    if not moving.any():
        raise InputError("no Gaussian moves that is of the mask and of the box; enlarge one of them, or still less")
    return moving


def _apply_request(
    moving: Bool[np.ndarray, " E"],
    places: Float32[np.ndarray, "E 3"],
    named: Sequence[tuple[Sequence[str], Int[np.ndarray, " E"]]],
    choice: CloudParams,
) -> Bool[np.ndarray, " E"]:
    """Apply a request to a mask of elements; `named` has lists of names, with each element's index or -1."""
    names = [name for some, _ in named for name in some]

    def chosen(option: str, patterns: Sequence[str] | None, box: Box | None) -> Bool[np.ndarray, " E"]:
        fits = matching(option, patterns, names)
        result = np.zeros(len(places), np.bool_) if box is None else in_box(places, box, f"{option}_box_m")
        for some, number in named:
            own, fits = fits[: len(some)], fits[len(some) :]
            result |= np.array([*own, False])[number]
        return result

    moving = moving | chosen("moving", choice.moving, choice.moving_box_m)
    moving &= ~chosen("still", choice.still, choice.still_box_m)
    return moving if choice.box_m is None else moving & in_box(places, choice.box_m)


def part_names(mesh: TriangleMesh) -> tuple[str, ...]:
    """List the names by which a request can select parts of a mesh: materials, and nodes or groups."""
    materials, parts = _names(mesh)
    return tuple(dict.fromkeys(name for name in [*materials, *parts] if name))


def _names(mesh: TriangleMesh) -> tuple[list[str], list[str]]:
    materials = [material.name for material in mesh.look.materials] if mesh.look.face_material is not None else []
    return materials, list(mesh.parts.names)


def matching(option: str, patterns: Sequence[str] | None, names: Sequence[str]) -> list[bool]:
    """Return whether each name matches a pattern, as a whole or by one component of its path; case is ignored.

    Raises:
        InputError: a pattern matches no name.
    """
    most_names = 30  # names in a message
    result = [False] * len(names)
    for pattern in patterns or ():
        fits = [
            bool(name) and any(fnmatchcase(step.lower(), pattern.lower()) for step in (name, *name.split("/")))
            for name in names
        ]
        if not any(fits):
            existing = [name for name in dict.fromkeys(names) if name]
            listed = ", ".join(existing[:most_names]) + (", …" if len(existing) > most_names else "")
            raise InputError(
                f"{option} names {pattern[:80]!r}, and no part is called so; "
                + (f"there are {listed}" if existing else f"no part has a name: take {option}_box_m")
            )
        result = [a or b for a, b in zip(result, fits, strict=True)]
    return result
