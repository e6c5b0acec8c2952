"""Axes and units of files: given by the caller or the format, or inferred from the shape of the tree.

Inside, everything is in metres and +Z up. glTF is +Y up and in metres by its specification. OBJ, PLY and STL say
neither, so both are worked out, and what was found is recorded in `source_up_axis` and `source_scale`:

- up is the likeliest of the six axes by several cues, see `upright.py`;
- the unit is the first of metre, centimetre and millimetre (STL: metre and millimetre) in which the tree is at most
  120 m tall.
"""

from dataclasses import replace

import numpy as np

from dynamictree.errors import InputError
from dynamictree.mesh import SourceWarning, TriangleMesh
from dynamictree.plant.upright import CERTAIN, UpAxis, judge_up_axis
from dynamictree.up_axis import up_rotation

TALLEST_TREE_M = 120.0  # Hyperion, the tallest tree known, is 116 m
USUAL_HEIGHT_M = (0.2, 60.0)
OTHERWISE = 0.95
"""How sure the shape must be of another axis than that of the format to be worth a warning."""
UNITS_M = (1.0, 0.01, 0.001)
UNIT_NAMES = {"centimetres": 0.01, "inches": 0.0254, "millimetres": 0.001, "metres": 1.0}


def mesh_to_z_up(
    mesh: TriangleMesh,
    *,
    up_axis: str | None,
    unit_m: float | None,
    height_m: float | None = None,
    habit: str | None = None,
    doubt_size: bool = False,
    units_m: tuple[float, ...] = UNITS_M,
) -> TriangleMesh:
    """Convert a mesh from its file's axes and unit to +Z up and metres; None is inferred.

    Args:
        mesh: in its file's axes and units.
        up_axis: the file's.
        unit_m: metres a unit of the file.
        height_m: of the tree as it is to be; decides the unit if given [m].
        habit: the axis that is usual in the file's format, if any.
        doubt_size: whether an unusual height, or a unit that was guessed, is worth a warning.
        units_m: that are usual in the file's format, the likeliest first.

    Raises:
        InputError: an unknown axis, or a unit that is not a positive length.
    """
    if unit_m is not None and not (np.isfinite(unit_m) and unit_m > 0):
        raise InputError(f"unit_m is {unit_m}; it must be positive and finite")
    judged = UpAxis(axis=up_axis, confidence=1.0) if up_axis else judge_up_axis(mesh, habit=habit)
    turned = mesh.vertices @ up_rotation(judged.axis).T  # [N, 3] float64
    matches = float(np.ptp(turned[:, 2])) if len(turned) else 0.0
    scale = scale_to(height_m, matches) or unit_m or guess_unit_m(matches, units_m)
    doubts = axis_warnings(judged)
    if doubt_size and not height_m:
        doubts += size_warnings(matches * scale, scale) or (guess_warnings(matches, scale) if unit_m is None else ())
    return replace(
        mesh,
        vertices=(turned * scale).astype(np.float32),
        normals=None if mesh.normals is None else (mesh.normals @ up_rotation(judged.axis).T).astype(np.float32),
        source_up_axis=judged.axis,
        source_up_confidence=round(judged.confidence, 3),
        source_scale=scale * mesh.source_scale,
        warnings=mesh.warnings + doubts,
    )


def scale_to(height_m: float | None, height: float) -> float | None:
    """Metres per unit for which a height in the file's units becomes the requested height.

    Raises:
        InputError: the model has no height.
    """
    if height_m is None:
        return None
    if not height > 0:
        raise InputError(f"height_m is {height_m:g}, but the model has no height along its up axis; set up_axis")
    return height_m / height


def axis_warnings(judged: UpAxis) -> tuple[SourceWarning, ...]:
    """Warnings about an up axis that the shape leaves uncertain."""
    if judged.confidence >= CERTAIN:
        return ()
    message = (
        f"the file does not say which way is up; {judged.axis} was taken with a confidence of "
        f"{judged.confidence:.0%}; set up_axis if the tree lies on its side"
    )
    return (SourceWarning(code="orientation-uncertain", message=message),)


def axis_doubts(judged: UpAxis | None, taken: str) -> tuple[SourceWarning, ...]:
    """A warning if a shape that was turned from `taken` up to +Z up clearly stands along another axis."""
    if judged is None or judged.axis == "+Z" or judged.confidence < OTHERWISE:
        return ()
    direction = up_rotation(taken).T @ up_rotation(judged.axis)[2]
    column = int(np.argmax(np.abs(direction)))
    axis = ("+" if direction[column] > 0 else "-") + "XYZ"[column]
    message = (
        f"{taken} was taken as up, as is usual in such files, but the shape stands upright along {axis} with a "
        f"confidence of {judged.confidence:.0%}; set up_axis to {axis} if the plant lies on its side"
    )
    return (SourceWarning(code="orientation-uncertain", message=message),)


def size_warnings(height_m: float, scale: float) -> tuple[SourceWarning, ...]:
    """Warnings about an unlikely height, with the unit that would make it usual."""
    if USUAL_HEIGHT_M[0] <= height_m <= USUAL_HEIGHT_M[1]:
        return ()
    heights = {name: (unit, height_m / scale * unit) for name, unit in UNIT_NAMES.items() if unit != scale}
    proposal = next(
        (
            f"; if the file is in {name}, set unit_m to {unit:g} ({height:.3g} m), or height_m to its height"
            for name, (unit, height) in heights.items()
            if 1 <= height <= USUAL_HEIGHT_M[1]
        ),
        "; set height_m to its height, or unit_m to the metres in one unit of the file",
    )
    low, high = USUAL_HEIGHT_M
    message = f"the model is {height_m:.4g} m tall, outside of the usual {low:g} to {high:g} m{proposal}"
    return (SourceWarning(code="size-doubtful", message=message),)


def guess_unit_m(height: float, units_m: tuple[float, ...] = UNITS_M) -> float:
    """Guess the metres per unit, by the rule above."""
    return next((unit for unit in units_m if height * unit <= TALLEST_TREE_M), 1.0)


def guess_warnings(height: float, scale: float) -> tuple[SourceWarning, ...]:
    """A warning that a unit other than the metre was guessed, with the heights in others."""
    if scale == 1.0:
        return ()
    others = [f"{height * unit:.3g} m in {name}" for name, unit in UNIT_NAMES.items() if unit not in (scale, 1.0)]
    names = {unit: name for name, unit in UNIT_NAMES.items()}
    message = (
        f"the file does not say its unit; {height:.4g} units were taken for {names[scale]} ({height * scale:.3g} m); "
        f"it would be {' or '.join(others)}: set unit_m, or height_m to its height"
    )
    return (SourceWarning(code="size-doubtful", message=message),)
