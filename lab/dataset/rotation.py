"""Unit quaternions (wxyz) with the components first, `[4, ...]`, for chains of small rotations."""

import numpy as np
from jaxtyping import Float32


def quaternion_of(vector: Float32[np.ndarray, "3 ..."]) -> Float32[np.ndarray, "4 ..."]:
    """Convert a rotation vector [rad] to a quaternion."""
    angle = np.sqrt((vector * vector).sum(axis=0))
    half = 0.5 * np.sinc(angle / (2 * np.pi))  # sin(angle / 2) / angle
    return np.concatenate([np.cos(angle / 2)[None], half * vector]).astype(np.float32)


def product(first: Float32[np.ndarray, "4 ..."], second: Float32[np.ndarray, "4 ..."]) -> Float32[np.ndarray, "4 ..."]:
    """Return the Hamilton product: the rotation `second`, then `first`."""
    a, b, c, d = first
    w, x, y, z = second
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


def to_matrix(quaternion: Float32[np.ndarray, "4 ..."]) -> Float32[np.ndarray, "3 3 ..."]:
    """Convert to a rotation matrix minus the identity."""
    w, x, y, z = quaternion
    rows = [
        [-2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), -2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), -2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row) for row in rows])


def rotate(
    quaternion: Float32[np.ndarray, "4 ..."], vector: Float32[np.ndarray, "3 ..."]
) -> Float32[np.ndarray, "3 ..."]:
    """Rotate a vector by each quaternion."""
    x, y, z = vector
    matrix = to_matrix(quaternion)
    turned = matrix[:, 0] * x + matrix[:, 1] * y + matrix[:, 2] * z
    return np.asarray(turned + vector, np.float32)
