"""Axes and units of files: stated by the caller or by the format, or inferred from how the tree stands.

Inside, everything is in metres and +Z up. glTF is +Y up and in metres by its specification. OBJ, PLY and STL say
neither, so both are worked out, and what was found is recorded in `source_up_axis` and `source_scale`:

- up is whichever of +Y and +Z the tree stands on with the narrower foot: the spread of the surface in the lowest tenth
  of the height, as a share of the spread of all of it. Within a fifth of each other, the taller of the two counts.
- the unit is the first of metre, centimetre and millimetre in which the tree is at most 120 m tall.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.errors import InputError
from dynamictree.mesh import SourceWarning, TriangleMesh

TALLEST_TREE_M = 120.0  # Hyperion, the tallest tree known, is 116 m
USUAL_HEIGHT_M = (0.2, 60.0)
UNITS_M = (1.0, 0.01, 0.001)

_FOOT_SHARE = 0.1  # of the height
_CLEARLY_NARROWER = 0.8

# rows are where the file's axes go; +Y is glTF's, −Y that of a scene reconstructed from photos (x right, y down)
_TO_Z_UP = {
    "+X": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-X": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "+Y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-Y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+Z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-Z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}


def up_rotation(up_axis: str) -> Float64[np.ndarray, "3 3"]:
    """Matrix that takes a file's axes to +Z up.

    Raises:
        InputError: an axis that is none of ±X, ±Y, ±Z.
    """
    if up_axis not in _TO_Z_UP:
        raise InputError(f"up_axis is {up_axis!r}; choose from {', '.join(_TO_Z_UP)}")
    return np.array(_TO_Z_UP[up_axis], np.float64)


def mesh_to_z_up(
    mesh: TriangleMesh, *, up_axis: str | None, unit_m: float | None, doubt_size: bool = False
) -> TriangleMesh:
    """Turn and scale a mesh as its file has it; None is worked out.

    Raises:
        InputError: an unknown axis, or a unit that is not a positive length.
    """
    if unit_m is not None and not (np.isfinite(unit_m) and unit_m > 0):
        raise InputError(f"unit_m is {unit_m}; it must be positive and finite")
    axis = up_axis or detect_up_axis(mesh)
    turned = mesh.vertices @ up_rotation(axis).T  # [N, 3] float64
    scale = unit_m or guess_unit_m(float(np.ptp(turned[:, 2])) if len(turned) else 0.0)
    height = float(np.ptp(turned[:, 2])) * scale if len(turned) else 0.0
    return replace(
        mesh,
        vertices=(turned * scale).astype(np.float32),
        source_up_axis=axis,
        source_scale=scale * mesh.source_scale,
        warnings=mesh.warnings + (size_warnings(height, scale) if doubt_size else ()),
    )


def size_warnings(height_m: float, scale: float) -> tuple[SourceWarning, ...]:
    """Doubt a height that trees hardly have, and propose the unit that makes it usual."""
    if USUAL_HEIGHT_M[0] <= height_m <= USUAL_HEIGHT_M[1]:
        return ()
    units = {"centimetres": 0.01, "inches": 0.0254, "millimetres": 0.001, "metres": 1.0}
    heights = {name: (unit, height_m / scale * unit) for name, unit in units.items() if unit != scale}
    proposal = next(
        (
            f"; if the file is in {name}, set unit_m to {unit:g} ({height:.3g} m)"
            for name, (unit, height) in heights.items()
            if 1 <= height <= USUAL_HEIGHT_M[1]
        ),
        "; set unit_m to the metres in one unit of the file",
    )
    low, high = USUAL_HEIGHT_M
    message = f"the model is {height_m:.4g} m tall, outside of the usual {low:g} to {high:g} m{proposal}"
    return (SourceWarning(code="size-doubtful", message=message),)


def vertices_in_source_axes(mesh: TriangleMesh, up_axis: str) -> Float32[np.ndarray, "N 3"]:
    """Positions with another axis up, still in metres: for writers."""
    positions: Float32[np.ndarray, "N 3"] = (mesh.vertices @ up_rotation(up_axis)).astype(np.float32)
    return positions


def detect_up_axis(mesh: TriangleMesh) -> str:
    """+Y or +Z, by the rule above."""
    if mesh.num_faces == 0:
        return "+Z"
    corners = mesh.vertices[mesh.faces].astype(np.float64)  # [F, 3, 3]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middles = corners.mean(axis=1)
    foot_y, foot_z = _foot_share(middles, areas, 1), _foot_share(middles, areas, 2)
    if min(foot_y, foot_z) < _CLEARLY_NARROWER * max(foot_y, foot_z):
        return "+Y" if foot_y < foot_z else "+Z"
    return "+Y" if np.ptp(mesh.vertices[:, 1]) > np.ptp(mesh.vertices[:, 2]) else "+Z"


def guess_unit_m(height: float) -> float:
    """Metres a unit, by the rule above."""
    return next((unit for unit in UNITS_M if height * unit <= TALLEST_TREE_M), 1.0)


def _foot_share(middles: Float64[np.ndarray, "F 3"], areas: Float64[np.ndarray, " F"], up: int) -> float:
    """Spread across the axis of the lowest tenth over that of all; 1 where there is nothing to tell by."""
    across = np.delete(middles, up, axis=1)  # [F, 2]
    height = middles[:, up]
    low = height <= height.min() + _FOOT_SHARE * np.ptp(height)
    whole = _spread(across, areas)
    return _spread(across[low], areas[low]) / whole if whole > 0 else 1.0


def _spread(points: Float64[np.ndarray, "F 2"], weights: Float64[np.ndarray, " F"]) -> float:
    total = weights.sum()
    if total <= 0:
        return 0.0
    middle = weights @ points / total
    return float(np.sqrt(weights @ ((points - middle) ** 2).sum(axis=1) / total))
