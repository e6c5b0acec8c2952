"""Harmonics that turn with their Gaussians, fast: the twin of `harmonics.turn_sh`, both cores and one pass."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32

from dynamictree.gaussian.harmonics import SH_CONSTANTS, sample_directions, sample_inverse
from dynamictree.render.kernel import in_bands

_SH = tuple(np.float32(constant) for constant in SH_CONSTANTS)
_TWO, _THREE, _FOUR = np.float32(2), np.float32(3), np.float32(4)
_STILL = 1e-7
"""Vector part of a quaternion below which nothing turns: float32 cannot tell."""


def turn_sh_fast(
    sh: Float32[np.ndarray, "G H 3"], quaternions: Float32[np.ndarray, "G 4"]
) -> Float32[np.ndarray, "G H 3"]:
    """Coefficients after each Gaussian turned; those that did not turn come back as they are."""
    degree = round(sh.shape[1] ** 0.5) - 1
    if degree == 0:
        return sh
    turned = np.empty_like(sh)
    in_bands(_turn, len(sh), sh, quaternions, degree, _directions(), _inverses(), turned)
    return turned


def _directions() -> Float32[np.ndarray, "15 3"]:
    return np.concatenate([sample_directions(degree) for degree in (1, 2, 3)]).astype(np.float32)


def _inverses() -> Float32[np.ndarray, "3 7 7"]:
    padded = np.zeros((3, 7, 7), np.float32)
    for degree in (1, 2, 3):
        padded[degree - 1, : 2 * degree + 1, : 2 * degree + 1] = sample_inverse(degree)
    return padded


_compiled = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})


@_compiled
@no_type_check
def harmonic_values(degree, x, y, z, values):
    """Y_h at one direction, to and with a degree; the twin of `harmonics.harmonics`."""
    values[0] = _SH[0]
    if degree >= 1:
        values[1], values[2], values[3] = -_SH[1] * y, _SH[1] * z, -_SH[1] * x
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        values[4], values[5] = _SH[2] * x * y, -_SH[2] * y * z
        values[6] = _SH[3] * (zz + zz - xx - yy)
        values[7], values[8] = -_SH[2] * x * z, _SH[4] * (xx - yy)
    if degree >= 3:
        xx, yy, zz = x * x, y * y, z * z
        four = _FOUR * zz - xx - yy
        values[9], values[10], values[11] = -_SH[5] * y * (_THREE * xx - yy), _SH[6] * x * y * z, -_SH[7] * y * four
        values[12] = _SH[8] * z * (zz + zz - _THREE * (xx + yy))
        values[13], values[14], values[15] = (
            -_SH[7] * x * four,
            _SH[9] * z * (xx - yy),
            -_SH[5] * x * (xx - _THREE * yy),
        )


@_compiled
@no_type_check
def _turn(first, end, sh, quaternions, degree, directions, inverses, turned):
    values, y = np.empty((7, 3), np.float32), np.empty(16, np.float32)
    for g in range(first, end):
        turned[g, 0] = sh[g, 0]
        qw, qx, qy, qz = quaternions[g, 0], -quaternions[g, 1], -quaternions[g, 2], -quaternions[g, 3]
        if abs(qx) + abs(qy) + abs(qz) < _STILL:
            turned[g] = sh[g]
            continue
        for level in range(1, degree + 1):
            width, start = 2 * level + 1, level * level
            for i in range(width):
                # the function's value where the sample direction came from, f(Rᵀ d)
                x0, y0, z0 = directions[start - 1 + i]
                cx, cy, cz = _TWO * (qy * z0 - qz * y0), _TWO * (qz * x0 - qx * z0), _TWO * (qx * y0 - qy * x0)
                dx, dy, dz = qw * cx + qy * cz - qz * cy, qw * cy + qz * cx - qx * cz, qw * cz + qx * cy - qy * cx
                harmonic_values(level, x0 + dx, y0 + dy, z0 + dz, y)
                for c in range(3):
                    total = np.float32(0)
                    for h in range(width):
                        total += y[start + h] * sh[g, start + h, c]
                    values[i, c] = total
            for h in range(width):
                for c in range(3):
                    total = np.float32(0)
                    for i in range(width):
                        total += inverses[level - 1, h, i] * values[i, c]
                    turned[g, start + h, c] = total
