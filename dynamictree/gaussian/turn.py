"""Rotation of spherical harmonics: f'(d) = f(Rᵀ d) at enough directions d, in one pass on all cores."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float32

from dynamictree.gaussian.harmonics import SH_CONSTANTS, sample_directions, sample_inverse
from dynamictree.parallel import compiled_fused, in_bands

_SH = tuple(np.float32(constant) for constant in SH_CONSTANTS)
_TWO, _THREE, _FOUR = np.float32(2), np.float32(3), np.float32(4)
_STILL = 1e-7
"""Vector part of a quaternion below which float32 represents no rotation."""


def turn_sh_fast(
    sh: Float32[np.ndarray, "G H 3"], quaternions: Float32[np.ndarray, "G 4"]
) -> Float32[np.ndarray, "G H 3"]:
    """Rotate the coefficients of each Gaussian; those without rotation are unchanged."""
    degree = round(sh.shape[1] ** 0.5) - 1
    if degree == 0:
        return sh
    turned = np.empty_like(sh)
    in_bands(_turn_table, len(sh), sh, quaternions, degree, _directions(), _inverses(), turned)
    return turned


def _directions() -> Float32[np.ndarray, "15 3"]:
    return np.concatenate([sample_directions(degree) for degree in (1, 2, 3)]).astype(np.float32)


def _inverses() -> Float32[np.ndarray, "3 7 7"]:
    padded = np.zeros((3, 7, 7), np.float32)
    for degree in (1, 2, 3):
        padded[degree - 1, : 2 * degree + 1, : 2 * degree + 1] = sample_inverse(degree)
    return padded


@compiled_fused
@no_type_check
def harmonic_values(degree, x, y, z, values):
    """Compute Y_h at one direction, up to and including a degree; counterpart of `harmonics.harmonics`."""
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


@compiled_fused
@no_type_check
def _turn_table(first, end, sh, quaternions, degree, directions, inverses, turned):
    """Rotate each Gaussian's coefficients above degree 0 by a quaternion w, x, y, z."""
    values, y = np.empty((7, 3), np.float32), np.empty(16, np.float32)
    for g in range(first, end):
        turned[g] = sh[g]
        qw, qx, qy, qz = quaternions[g]
        if abs(qx) + abs(qy) + abs(qz) < _STILL:
            continue
        for level in range(1, degree + 1):
            width, start = 2 * level + 1, level * level
            for i in range(width):
                # value of the function at the direction rotated back, f(Rᵀ d)
                x0, y0, z0 = directions[start - 1 + i]
                cx, cy, cz = _TWO * (qz * y0 - qy * z0), _TWO * (qx * z0 - qz * x0), _TWO * (qy * x0 - qx * y0)
                dx, dy, dz = qw * cx - qy * cz + qz * cy, qw * cy - qz * cx + qx * cz, qw * cz - qx * cy + qy * cx
                harmonic_values(level, x0 + dx, y0 + dy, z0 + dz, y)
                red, green, blue = np.float32(0), np.float32(0), np.float32(0)
                for h in range(start, start + width):
                    red += y[h] * sh[g, h, 0]
                    green += y[h] * sh[g, h, 1]
                    blue += y[h] * sh[g, h, 2]
                values[i, 0], values[i, 1], values[i, 2] = red, green, blue
            for h in range(width):
                red, green, blue = np.float32(0), np.float32(0), np.float32(0)
                for i in range(width):
                    share = inverses[level - 1, h, i]
                    red += share * values[i, 0]
                    green += share * values[i, 1]
                    blue += share * values[i, 2]
                turned[g, start + h, 0], turned[g, start + h, 1], turned[g, start + h, 2] = red, green, blue
