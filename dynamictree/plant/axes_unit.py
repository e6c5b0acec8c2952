"""Axes and units of sources: given by the request or the file, or inferred from the tree's shape.

In memory, everything is in metres and +Z up. glTF is +Y up and in metres by its specification. OBJ, PLY and STL state
neither, so both are inferred, and the result is recorded in `Source`:

- up is the likeliest of the six axes by several cues, see `upright.py`;
- the unit is the first of metre, centimetre and millimetre (STL: metre and millimetre) in which the tree is at most
  120 m tall. The scale of a splat is arbitrary: without a stated unit or height it becomes 5 m tall.
"""

from dataclasses import dataclass, replace

import numpy as np

from dynamictree.errors import InputError
from dynamictree.gaussian.axes import transform_cloud
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import SourceWarning, TriangleMesh
from dynamictree.plant.plausibility import FEWEST_FACES
from dynamictree.plant.still import height_of
from dynamictree.plant.still_cloud import find_sky
from dynamictree.plant.upright import CERTAIN, USUAL_AXES, UpAxis, judge_up_axis
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation

USUAL_HEIGHT_M = (0.2, 60.0)
DEFAULT_HEIGHT_M = 5.0
"""Height of a splat without a stated unit."""
UNITS_M = (1.0, 0.01, 0.001)
UNIT_NAMES = {"centimetres": 0.01, "inches": 0.0254, "feet": 0.3048, "millimetres": 0.001, "metres": 1.0}


@dataclass(frozen=True, kw_only=True)
class Conventions:
    """Axis and unit that a file states, and the usual ones of its format."""

    up_axis: str | None = None
    unit_m: float | None = None
    usual_up_axis: str | None = None
    usual_units_m: tuple[float, ...] = UNITS_M


def mesh_to_z_up(mesh: TriangleMesh, reading: Reading, file: Conventions) -> TriangleMesh:
    """Rotate and scale a mesh by the request or the file; infer axis and unit if neither states them.

    Raises:
        InputError: the axis is unknown, or a height is requested for a model without height.
    """
    stated = reading.up_axis or file.up_axis
    judged = UpAxis(axis=stated, confidence=1.0) if stated else judge_up_axis(mesh, habit=file.usual_up_axis)
    turned = mesh.vertices @ up_rotation(judged.axis).T  # [N, 3] float64
    height = float(np.ptp(turned[:, 2])) if len(turned) else 0.0
    unit_m = reading.unit_m or file.unit_m or guess_unit_m(height, file.usual_units_m)
    scale = unit_m if reading.height_m is None else scale_to(reading.height_m, height)
    normals = None if mesh.look.normals is None else (mesh.look.normals @ up_rotation(judged.axis).T).astype(np.float32)
    return replace(
        mesh,
        vertices=(turned * scale).astype(np.float32),
        look=replace(mesh.look, normals=normals),
        source=replace(
            mesh.source, up_axis=judged.axis, up_confidence=round(judged.confidence, 3), scale=scale * mesh.source.scale
        ),
        warnings=mesh.warnings + axis_warnings(judged, file.usual_up_axis),
    )


def scale_cloud(
    cloud: GaussianCloud, *, height_m: float | None, stated: bool, keep: bool = False
) -> tuple[GaussianCloud, tuple[SourceWarning, ...]]:
    """Scale a cloud to a height, or to the default one if its unit is not `stated`; warn of doubtful sizes.

    With `keep`, for points made from photos, the file's unit is taken as the metre if the height is then usual.
    """
    detected = cloud_height(cloud)
    if height_m is None and (stated or detected == 0):
        return cloud, height_warnings(detected, cloud.source.scale) if detected > 0 else ()
    keep &= USUAL_HEIGHT_M[0] <= detected <= USUAL_HEIGHT_M[1]
    scale = scale_to(height_m or (detected if keep else DEFAULT_HEIGHT_M), detected)
    source = replace(cloud.source, scale=cloud.source.scale * scale)
    scaled = replace(transform_cloud(cloud, np.eye(3), scale), source=source)
    if height_m is not None:
        return scaled, ()
    message = (
        f"the file of a {'cloud made from photos' if keep else 'splat'} does not say how large it is; {detected:.3g} "
        f"units were taken for {detected if keep else DEFAULT_HEIGHT_M:.3g} m; set height_m to its height, or unit_m "
        "to the metres in one unit of the file; and box_m to the plant if the file shows more than it, such as a room"
    )
    return scaled, (SourceWarning(code="size-unknown", message=message),)


def cloud_height(cloud: GaussianCloud) -> float:
    """Return the extent along +Z without sky and strays [m]."""
    return height_of(cloud.means[~find_sky(cloud)].astype(np.float64))


def scale_to(height_m: float, height: float) -> float:
    """Return the metres per unit that turn a height in the file's units into the requested one.

    Raises:
        InputError: the model has no height.
    """
    if not height > 0:
        raise InputError(f"height_m is {height_m:g}, but the model has no height along its up axis; set up_axis")
    return height_m / height


def guess_unit_m(height: float, units_m: tuple[float, ...] = UNITS_M) -> float:
    """Guess the metres per unit, by the rule in the module's docstring."""
    tallest_tree_m = 120.0  # Hyperion, the tallest tree known, is 116 m
    return next((unit for unit in units_m if height * unit <= tallest_tree_m), 1.0)


def axis_warnings(judged: UpAxis, usual: str | None) -> tuple[SourceWarning, ...]:
    """Warn of an inferred up axis that is uncertain or unusual."""
    # enough for the usual axis of a format: of 224 readings, 1 is wrong below `CERTAIN`
    probably = 0.5
    if judged.confidence >= (probably if judged.axis == usual else CERTAIN) and judged.axis in (*USUAL_AXES, usual):
        return ()
    message = (
        f"the file does not say which way is up; {judged.axis} was taken with a confidence of "
        f"{judged.confidence:.0%}; set up_axis if the tree lies on its side"
    )
    return (SourceWarning(code="orientation-uncertain", message=message),)


def axis_doubts(judged: UpAxis | None, taken: str) -> tuple[SourceWarning, ...]:
    """Warn if a shape that was rotated from `taken` to +Z is far likelier to stand along another axis."""
    # ratio of probabilities to a stated axis from which to warn: none of 14 standing species, all lying ones
    otherwise = 5.0
    likely = 0.5  # larger than all others together
    if judged is None or judged.axis == "+Z" or judged.confidence < max(otherwise * judged.upright, likely):
        return ()
    direction = up_rotation(taken).T @ up_rotation(judged.axis)[2]
    column = int(np.argmax(np.abs(direction)))
    axis = ("+" if direction[column] > 0 else "-") + "XYZ"[column]
    message = (
        f"{taken} was taken as up, as is usual in such files, but the shape stands upright along {axis} with a "
        f"confidence of {judged.confidence:.0%}; set up_axis to {axis} if the plant lies on its side"
    )
    return (SourceWarning(code="orientation-uncertain", message=message),)


def size_doubts(mesh: TriangleMesh, *, file_unit: bool) -> tuple[SourceWarning, ...]:
    """Warn of an unlikely size of one plant, and of a guessed unit; `file_unit` tells if the file states one.

    Tools that generate meshes from pictures scale objects to a cube, also in glTF, whose unit is the metre.
    """
    cubes, of_cube = (1.0, 2.0), 1e-3  # longest sides of meshes that a tool scaled, and relative tolerance
    scale, plant = mesh.source.scale, mesh.moving_part
    sides = np.ptp(plant.vertices[plant.faces.ravel()], axis=0).tolist()
    height, longest = sides[2], float(np.ptp(mesh.vertices[mesh.faces.ravel()], axis=0).max()) / scale
    if unlikely := height_warnings(height, scale) or crown_warnings(sides, scale):
        return unlikely
    if not file_unit and scale != 1.0:
        names = {unit: name for name, unit in UNIT_NAMES.items()}
        taken = f"taken for {names.get(scale, f'{scale:g} m each')} ({height:.3g} m)"
        what = f"the file does not say its unit; {height / scale:.4g} units were {taken}"
    elif (not file_unit or mesh.num_faces >= FEWEST_FACES) and any(abs(longest / side - 1) < of_cube for side in cubes):
        what = f"the longest side is {longest:.3g} units, as of meshes that a tool scaled to a cube, taken for metres"
    else:
        return ()
    return _size_warning(what, height, scale)


def height_warnings(height_m: float, scale: float) -> tuple[SourceWarning, ...]:
    """Warn of an unlikely height, and name the units that would make it usual."""
    low, high = USUAL_HEIGHT_M
    what = f"the model is {height_m:.4g} m tall, outside of the usual {low:g} to {high:g} m"
    return () if low <= height_m <= high else _size_warning(what, height_m, scale)


def crown_warnings(sides_m: list[float], scale: float) -> tuple[SourceWarning, ...]:
    """Warn if one plant of a usual height is unusually wide."""
    # 1.5 times the widest crown of the sample trees, which is 20 m
    widest_crown_m = 30.0
    width_m, height_m = max(sides_m[:2]), sides_m[2]
    what = f"the plant is {height_m:.3g} m tall and {width_m:.3g} m wide, and few crowns are so wide"
    doubtful = width_m > widest_crown_m and not height_warnings(height_m, scale)
    return _size_warning(f"{what}; cut one tree out if it is several", height_m, scale) if doubtful else ()


def _size_warning(what: str, height_m: float, scale: float) -> tuple[SourceWarning, ...]:
    heights = {name: (unit, height_m / scale * unit) for name, unit in UNIT_NAMES.items() if unit != scale}
    usual = {name: own for name, own in heights.items() if USUAL_HEIGHT_M[0] <= own[1] <= USUAL_HEIGHT_M[1]} or heights
    others = " or ".join(f"{own:.3g} m in {name} (unit_m {unit:g})" for name, (unit, own) in usual.items())
    message = f"{what}; it would be {others}: set unit_m, or height_m to its height"
    return (SourceWarning(code="size-doubtful", message=message),)
