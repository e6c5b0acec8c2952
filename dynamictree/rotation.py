"""Rotations: unit quaternions wxyz and matrices."""

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Float, Float32

from dynamictree.errors import InputError


def quaternion_matrices(quaternions: Float[np.ndarray, "G 4"]) -> Float[np.ndarray, "G 3 3"]:
    """Return the rotation matrix of each unit quaternion; its columns are the turned axes."""
    turns = scipy.spatial.transform.Rotation.from_quat(quaternions, scalar_first=True)
    return np.asarray(turns.as_matrix(), quaternions.dtype)


def matrix_quaternions(rotations: Float[np.ndarray, "G 3 3"]) -> Float[np.ndarray, "G 4"]:
    """Return the unit quaternion of each rotation matrix, with w >= 0."""
    turns = scipy.spatial.transform.Rotation.from_matrix(rotations, assume_valid=True)
    return np.asarray(turns.as_quat(canonical=True, scalar_first=True), rotations.dtype)


def quaternion_products(left: Float[np.ndarray, "#G 4"], right: Float[np.ndarray, "#G 4"]) -> Float[np.ndarray, "#G 4"]:
    """Multiply quaternions: the product rotates by `right`, then by `left`."""
    w1, x1, y1, z1 = left.T
    w2, x2, y2, z2 = right.T
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=1,
    )


def about_z(angle_rad: float) -> Float32[np.ndarray, "3 3"]:
    """Return the matrix of a rotation from +X towards +Y."""
    return np.asarray(scipy.spatial.transform.Rotation.from_euler("z", angle_rad).as_matrix(), np.float32)


def unit_quaternions(quaternions: Float32[np.ndarray, "G 4"]) -> Float32[np.ndarray, "G 4"]:
    """Normalise quaternions to unit length.

    Raises:
        InputError: a quaternion of length zero, which is no rotation.
    """
    length = np.linalg.norm(quaternions.astype(np.float64), axis=1)
    if length.size and not length.min() > 0:
        index = int(np.argmin(length))
        raise InputError(
            f"the quaternion of Gaussian {index} is {quaternions[index].tolist()}; a rotation has a length"
        )
    return np.asarray(quaternions / length[:, None], np.float32)
