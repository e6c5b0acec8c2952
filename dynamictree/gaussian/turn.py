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


def turn_sh_rows(
    sh: Float32[np.ndarray, "G H 3"],
    rest: Float32[np.ndarray, "G 4"],
    now: Float32[np.ndarray, "G 4"],
    rows: Float32[np.ndarray, "G P"],
) -> None:
    """Write the rotated coefficients above degree 0 into rows of a 3DGS PLY, channel by channel."""
    degree = round(sh.shape[1] ** 0.5) - 1
    if degree > 0:
        in_bands(_turn_rows, len(sh), sh, rest, now, degree, _directions(), _inverses(), rows)


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
def _turn_one(sh, qw, qx, qy, qz, degree, directions, inverses, values, y, turned):
    """Rotate one Gaussian's coefficients above degree 0 by a quaternion w, x, y, z."""
    still = abs(qx) + abs(qy) + abs(qz) < _STILL
    for level in range(1, degree + 1):
        width, start = 2 * level + 1, level * level
        if still:
            turned[start : start + width] = sh[start : start + width]
            continue
        for i in range(width):
            # value of the function at the direction rotated back, f(Rᵀ d)
            x0, y0, z0 = directions[start - 1 + i]
            cx, cy, cz = _TWO * (qz * y0 - qy * z0), _TWO * (qx * z0 - qz * x0), _TWO * (qy * x0 - qx * y0)
            dx, dy, dz = qw * cx - qy * cz + qz * cy, qw * cy - qz * cx + qx * cz, qw * cz - qx * cy + qy * cx
            harmonic_values(level, x0 + dx, y0 + dy, z0 + dz, y)
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for h in range(start, start + width):
                red += y[h] * sh[h, 0]
                green += y[h] * sh[h, 1]
                blue += y[h] * sh[h, 2]
            values[i, 0], values[i, 1], values[i, 2] = red, green, blue
        for h in range(width):
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for i in range(width):
                share = inverses[level - 1, h, i]
                red += share * values[i, 0]
                green += share * values[i, 1]
                blue += share * values[i, 2]
            turned[start + h, 0], turned[start + h, 1], turned[start + h, 2] = red, green, blue


@compiled_fused
@no_type_check
def _turn_table(first, end, sh, quaternions, degree, directions, inverses, turned):
    values, y = np.empty((7, 3), np.float32), np.empty(16, np.float32)
    for g in range(first, end):
        turned[g, 0] = sh[g, 0]
        w, x, y_, z = quaternions[g]
        _turn_one(sh[g], w, x, y_, z, degree, directions, inverses, values, y, turned[g])


@compiled_fused
@no_type_check
def _turn_rows(first, end, sh, rest, now, degree, directions, inverses, rows):
    values, y, turned = np.empty((7, 3), np.float32), np.empty(16, np.float32), np.empty((16, 3), np.float32)
    num_rest = sh.shape[1] - 1
    for g in range(first, end):
        a, b, c, d = now[g, 0], now[g, 1], now[g, 2], now[g, 3]
        e, f, h, k = rest[g, 0], -rest[g, 1], -rest[g, 2], -rest[g, 3]
        w, x = a * e - b * f - c * h - d * k, a * f + b * e + c * k - d * h
        y_, z = a * h - b * k + c * e + d * f, a * k + b * h - c * f + d * e
        _turn_one(sh[g], w, x, y_, z, degree, directions, inverses, values, y, turned)
        for channel in range(3):
            for i in range(num_rest):
                rows[g, 9 + channel * num_rest + i] = turned[1 + i, channel]
