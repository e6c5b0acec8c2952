"""Which way is up in a file: one of its axes, such as `-Y`, or a direction in them, such as `0.1736,-0.9698,0.171`."""

import math
import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.errors import InputError

AXES = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
_NUMBER = r"-?[0-9]+(\.[0-9]+)?"
DIRECTION_PATTERN = f"{_NUMBER},{_NUMBER},{_NUMBER}"
UP_AXIS_PATTERN = rf"[+-][XYZ]|{DIRECTION_PATTERN}"
Direction = tuple[float, float, float]
"""A unit vector."""
_SHORTEST = 1e-3  # of a direction that says something
_DIGITS = 4  # of a unit vector's coordinates: a hundredth of a degree


# rows are where the file's axes go; +Y is glTF's, −Y that of a scene reconstructed from photos (x right, y down)
_TO_Z_UP = {
    "+X": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-X": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "+Y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-Y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+Z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-Z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}


def direction_of(name: str) -> Direction:
    """The unit vector of an axis or direction.

    Raises:
        InputError: the name is none, or a direction without length.
    """
    if not re.fullmatch(UP_AXIS_PATTERN, name):
        raise InputError(f"up_axis is {name[:80]!r}; choose from {', '.join(AXES)}, or a direction as 0.17,-0.97,0.17")
    if name in AXES:
        sign = 1.0 if name[0] == "+" else -1.0
        return (sign * (name[1] == "X"), sign * (name[1] == "Y"), sign * (name[1] == "Z"))
    numbers = [float(number) for number in name.split(",")]
    length = math.hypot(*numbers)
    if not _SHORTEST <= length < math.inf:
        raise InputError(f"up_axis is {name[:80]!r}; a direction has a length, such as 0.17,-0.97,0.17")
    x, y, z = (number / length for number in numbers)
    return x, y, z


def name_of(direction: Sequence[float]) -> str:
    """The name of a direction of any length; `direction_of` undoes it to a hundredth of a degree."""
    length = math.hypot(*direction)
    unit = tuple(round(number / length, _DIGITS) + 0.0 for number in direction)  # no minus zero
    axis = next((name for name in AXES if direction_of(name) == unit), None)
    return axis or ",".join(f"{number:.{_DIGITS}f}".rstrip("0").rstrip(".") for number in unit)


def up_rotation(up_axis: str) -> Float64[np.ndarray, "3 3"]:
    """Matrix that takes a file's axes to +Z up; for a direction, by the nearest axis and the smallest turn from there.

    Raises:
        InputError: a name that `direction_of` does not know.
    """
    direction = np.array(direction_of(up_axis))
    nearest = max(AXES, key=lambda axis: float(np.array(direction_of(axis)) @ direction))
    rotation = np.array(_TO_Z_UP[nearest], np.float64)
    return turn_to_z(rotation @ direction) @ rotation


def turn_to_z(direction: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, "3 3"]:
    """The smallest turn from a unit vector, not -Z, to +Z (Rodrigues)."""
    x, y, z = direction
    tilt = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    turn: Float64[np.ndarray, "3 3"] = np.eye(3) + tilt + tilt @ tilt / (1 + z)
    return turn


def vertices_in_source_axes(vertices: Float32[np.ndarray, "N 3"], up_axis: str) -> Float32[np.ndarray, "N 3"]:
    """Positions that have +Z up with another axis up: for writers."""
    positions: Float32[np.ndarray, "N 3"] = (vertices @ up_rotation(up_axis)).astype(np.float32)
    return positions
