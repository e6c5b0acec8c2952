"""Rotations between the axes of a file and those in memory, where +Z is up."""

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.axis_names import AXES, direction_of

# row i is the new axis i in the file's axes; +Y is glTF's up, −Y that of scenes reconstructed from photos (y down)
_TO_Z_UP = {
    "+X": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-X": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "+Y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-Y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+Z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-Z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}


def up_rotation(up_axis: str) -> Float64[np.ndarray, "3 3"]:
    """Return the rotation from a file's axes to +Z up; a direction goes by its nearest axis and the smallest turn.

    Raises:
        InputError: the name is no axis and no direction.
    """
    direction = np.array(direction_of(up_axis))
    nearest = max(AXES, key=lambda axis: float(np.array(direction_of(axis)) @ direction))
    rotation = np.array(_TO_Z_UP[nearest], np.float64)
    return turn_to_z(rotation @ direction) @ rotation


def turn_to_z(direction: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, "3 3"]:
    """Return the smallest rotation from a unit vector, other than -Z, to +Z (Rodrigues)."""
    x, y, z = direction
    tilt = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    turn: Float64[np.ndarray, "3 3"] = np.eye(3) + tilt + tilt @ tilt / (1 + z)
    return turn


def vertices_in_source_axes(vertices: Float32[np.ndarray, "N 3"], up_axis: str) -> Float32[np.ndarray, "N 3"]:
    """Convert positions with +Z up to the axes of a file, for writers."""
    return np.asarray(vertices @ up_rotation(up_axis), np.float32)
