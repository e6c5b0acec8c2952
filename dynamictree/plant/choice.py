"""Choose the moving parts of a mesh, splat or scan: detected ones, changed by the request's names and boxes."""

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh
from dynamictree.request_model import Box
from dynamictree.requests import CloudParams

_MOST_NAMES = 30  # of a message


def with_choice(mesh: TriangleMesh, choice: CloudParams) -> TriangleMesh:
    """The mesh, its still faces as the request says; what it does not say stays as detected.

    Raises:
        InputError: a name or box that fits nothing, or nothing is left to move.
    """
    names = _names(mesh)
    owner = [mesh.look.face_material, mesh.parts.of_face]
    middles = mesh.vertices[mesh.faces].mean(axis=1, dtype=np.float32)
    still = np.zeros(mesh.num_faces, np.bool_) if mesh.still_faces is None else mesh.still_faces.copy()

    def chosen(option: str, patterns: Sequence[str] | None, box: Box | None) -> Bool[np.ndarray, " F"]:
        result = np.zeros(mesh.num_faces, np.bool_)
        for number, one in enumerate(_matching(option, patterns, [*names[0], *names[1]])):
            source, row = (0, number) if number < len(names[0]) else (1, number - len(names[0]))
            faces = owner[source]
            if one and faces is not None:
                result |= faces == row
        return result if box is None else result | _inside(f"{option}_box_m", middles, box)

    still &= ~chosen("moving", choice.moving, choice.moving_box_m)
    still |= chosen("still", choice.still, choice.still_box_m)
    if choice.box_m is not None:
        still |= ~_inside("box_m", middles, choice.box_m)
    if still.all():
        raise InputError("still, still_box_m and box_m leave no face that moves; take something out of them")
    return replace(mesh, still_faces=still if still.any() else None)


def choose_gaussians(
    means: Float32[np.ndarray, "G 3"],
    may_move: Bool[np.ndarray, " G"],
    parts: Sequence[str],
    part_of: UInt8[np.ndarray, " G"] | None,
    choice: CloudParams,
) -> Bool[np.ndarray, " G"]:
    """Which Gaussians move: those that may, with what the request says by the names of detected parts and by boxes.

    Raises:
        InputError: a name or box that fits nothing, or nothing is left to move.
    """
    moving = may_move.copy()

    def chosen(option: str, patterns: Sequence[str] | None, box: Box | None) -> Bool[np.ndarray, " G"]:
        fits = [False, *_matching(option, patterns, parts)]
        result = np.zeros(len(means), np.bool_) if part_of is None else np.array(fits)[part_of]
        return result if box is None else result | _inside(f"{option}_box_m", means, box)

    moving |= chosen("moving", choice.moving, choice.moving_box_m)
    moving &= ~chosen("still", choice.still, choice.still_box_m)
    if choice.box_m is not None:
        moving &= _inside("box_m", means, choice.box_m)
    if not moving.any():
        raise InputError("no Gaussian moves that is of the mask and of the box; enlarge one of them, or still less")
    return moving


def part_names(mesh: TriangleMesh) -> tuple[str, ...]:
    """By which parts of a mesh can be named: materials, and nodes or groups."""
    materials, parts = _names(mesh)
    return tuple(dict.fromkeys(name for name in [*materials, *parts] if name))


def _names(mesh: TriangleMesh) -> tuple[list[str], list[str]]:
    materials = [material.name for material in mesh.look.materials] if mesh.look.face_material is not None else []
    return materials, list(mesh.parts.names)


def _matching(option: str, patterns: Sequence[str] | None, names: Sequence[str]) -> list[bool]:
    """Which names fit one of the patterns, as a whole or in a step of their path; case does not count."""
    result = [False] * len(names)
    for pattern in patterns or ():
        fits = [_fits(name.lower(), pattern.lower()) for name in names]
        if not any(fits):
            existing = [name for name in dict.fromkeys(names) if name]
            listed = ", ".join(existing[:_MOST_NAMES]) + (", …" if len(existing) > _MOST_NAMES else "")
            raise InputError(
                f"{option} names {pattern[:80]!r}, and no part is called so; "
                + (f"there are {listed}" if existing else f"no part has a name: take {option}_box_m")
            )
        result = [a or b for a, b in zip(result, fits, strict=True)]
    return result


def _fits(name: str, pattern: str) -> bool:
    return bool(name) and any(fnmatchcase(step, pattern) for step in (name, *name.split("/")))


def _inside(option: str, points: Float32[np.ndarray, "P 3"], box: Box) -> Bool[np.ndarray, " P"]:
    low, high = np.asarray(box[0]), np.asarray(box[1])
    if not (low < high).all():
        raise InputError(
            f"{option} runs from {box[0]} to {box[1]}; its low corner must be below its high one in x, y and z"
        )
    inside = np.asarray(((points >= low) & (points <= high)).all(axis=1))
    if not inside.any():
        bounds = points.min(axis=0).round(3).tolist(), points.max(axis=0).round(3).tolist()
        raise InputError(
            f"nothing is in {option} from {box[0]} to {box[1]}; the source is from {bounds[0]} to {bounds[1]}"
        )
    return inside
