"""Rotations: unit quaternions wxyz, matrices, and the rotation nearest to a deformation gradient."""

import numpy as np
from jaxtyping import Float, Float32

from dynamictree.errors import InputError


def quaternion_matrices(quaternions: Float[np.ndarray, "G 4"]) -> Float[np.ndarray, "G 3 3"]:
    """The rotation matrix of each unit quaternion; its columns are the turned axes."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.array(rows, quaternions.dtype).transpose(2, 0, 1))  # [G, 3, 3]


def matrix_quaternions(rotations: Float[np.ndarray, "G 3 3"]) -> Float[np.ndarray, "G 4"]:
    """The unit quaternion of each rotation matrix, w >= 0. Shepperd 1978: divide by the largest component."""
    diagonal = np.diagonal(rotations, axis1=1, axis2=2)  # [G, 3]
    trace = diagonal.sum(axis=1)
    # 4 times the square of w, x, y, z
    squares = np.concatenate([(1 + trace)[:, None], 1 + 2 * diagonal - trace[:, None]], axis=1)  # [G, 4]
    largest = np.argmax(squares, axis=1)
    r = rotations
    products = np.empty((len(r), 4, 4), rotations.dtype)  # 4 times w, x, y, z times one another
    products[:, [0, 1, 2, 3], [0, 1, 2, 3]] = squares
    for i, j, value in (
        (0, 1, r[:, 2, 1] - r[:, 1, 2]),
        (0, 2, r[:, 0, 2] - r[:, 2, 0]),
        (0, 3, r[:, 1, 0] - r[:, 0, 1]),
        (1, 2, r[:, 0, 1] + r[:, 1, 0]),
        (1, 3, r[:, 0, 2] + r[:, 2, 0]),
        (2, 3, r[:, 1, 2] + r[:, 2, 1]),
    ):
        products[:, i, j] = products[:, j, i] = value
    chosen = products[np.arange(len(r)), largest]
    chosen /= np.linalg.norm(chosen, axis=1, keepdims=True)
    result: Float[np.ndarray, "G 4"] = np.where(chosen[:, :1] < 0, -chosen, chosen)
    return result


def quaternion_products(left: Float[np.ndarray, "#G 4"], right: Float[np.ndarray, "#G 4"]) -> Float[np.ndarray, "#G 4"]:
    """Turn by `right`, then by `left`."""
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


def unit_quaternions(quaternions: Float32[np.ndarray, "G 4"]) -> Float32[np.ndarray, "G 4"]:
    """Scale to length one.

    Raises:
        InputError: a quaternion of length zero, which is no rotation.
    """
    length = np.linalg.norm(quaternions.astype(np.float64), axis=1)
    if length.size and not length.min() > 0:
        index = int(np.argmin(length))
        raise InputError(
            f"the quaternion of Gaussian {index} is {quaternions[index].tolist()}; a rotation has a length"
        )
    result: Float32[np.ndarray, "G 4"] = (quaternions / length[:, None]).astype(np.float32)
    return result


def polar_rotations(gradients: Float[np.ndarray, "F 3 3"]) -> Float[np.ndarray, "F 3 3"]:
    """R of the polar decomposition F = R S: the rotation nearest to a deformation gradient, never a mirror."""
    u, _, vt = np.linalg.svd(gradients)
    mirrored = np.linalg.det(u @ vt) < 0
    u[mirrored, :, 2] *= -1  # the least stretched axis turns round
    result: Float[np.ndarray, "F 3 3"] = u @ vt
    return result
