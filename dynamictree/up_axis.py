"""Rotations between the axes of a file and those in memory, where +Z is up."""

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.axis_names import AXES, direction_of

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
