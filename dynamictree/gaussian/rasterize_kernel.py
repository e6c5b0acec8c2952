"""Kernels of `rasterize`: project Gaussians, list them by tiles, blend the tiles."""

from typing import no_type_check

import numpy as np

from dynamictree.gaussian.turn import harmonic_values
from dynamictree.parallel import compiled_fused

TILE = 16  # [px] per side; a row of a tile is one vector of 16 floats
NEAR_M = 0.02
"""Near plane: least depth that is drawn [m]."""
PIXEL_PX2 = 0.1
"""Variance added to every ellipse [px²], about a pixel's own, for the antialiasing of Mip-Splatting."""
MIN_ALPHA = 1 / 255
MAX_ALPHA = 0.99  # bounds of alpha: Kerbl et al. 2023, appendix C
WIDEST = 1.3  # [half picture]; slopes of the projection are clamped beyond, as in the code of Kerbl et al.
_OPAQUE = np.float32(1e-4)  # transmittance at which a tile is finished, Kerbl et al. 2023, section 6

_HALF, _ONE, _TWO = np.float32(0.5), np.float32(1), np.float32(2)
_NEAR, _PIXEL = np.float32(NEAR_M), np.float32(PIXEL_PX2)
_MIN, _MAX = np.float32(MIN_ALPHA), np.float32(MAX_ALPHA)
_SIZE = TILE * TILE
# unsigned: indices cannot wrap around, so LLVM vectorizes the loop, which is 6 times as fast
_LANES = np.uint32(TILE)
_GREEN, _BLUE, _DEPTH, _LIGHT = (np.uint32(plane * _SIZE) for plane in range(1, 5))
_EXP = tuple(np.float32(c) for c in (1 / 120, 1 / 24, 1 / 6, 1 / 2, 1, 1))
_SIXTEENTH = np.float32(1 / 16)


@compiled_fused
@no_type_check
def project(first, end, means, quaternions, scales, opacity, sh, rest, view, turned, ellipses, bounds):
    """Compute each Gaussian's ellipse (centre, conic, opacity), colour, depth and bounds [px]."""
    degree = round(np.sqrt(sh.shape[1])) - 1
    values = np.empty(16, np.float32)
    axes, half = np.empty((3, 3), np.float32), np.empty((3, 2), np.float32)
    for g in range(first, end):
        dx, dy, dz = means[g, 0] - view[9], means[g, 1] - view[10], means[g, 2] - view[11]
        x = view[0] * dx + view[1] * dy + view[2] * dz
        y = view[3] * dx + view[4] * dy + view[5] * dz
        z = view[6] * dx + view[7] * dy + view[8] * dz
        if not z >= _NEAR:  # also for NaN
            continue
        rotation_axes(quaternions[g], axes)
        per_z = view[12] / z
        slope_x, slope_y = min(max(x / z, -view[17]), view[17]), min(max(y / z, -view[18]), view[18])
        for i in range(3):
            half[i, 0], half[i, 1], _ = half_axis(axes, scales[g, i], i, view, slope_x, slope_y, per_z)
        xx, xy, yy, sharp, determinant = covariance(half)
        visible_opacity = opacity[g] * np.sqrt(sharp / determinant)
        if not visible_opacity >= _MIN:  # also for NaN
            continue
        reach = _TWO * np.log(visible_opacity / _MIN)  # squared standard deviations at which alpha is `_MIN`
        column, row = x * per_z + view[13], y * per_z + view[14]
        wide, high = np.sqrt(reach * xx), np.sqrt(reach * yy)
        left, right = int(np.ceil(column - wide - _HALF)), int(np.floor(column + wide - _HALF)) + 1
        top, bottom = int(np.ceil(row - high - _HALF)), int(np.floor(row + high - _HALF)) + 1
        left, right, top, bottom = max(left, 0), min(right, int(view[15])), max(top, 0), min(bottom, int(view[16]))
        if left >= right or top >= bottom:
            continue
        bounds[g, 0], bounds[g, 1], bounds[g, 2], bounds[g, 3] = left, right, top, bottom
        per = _ONE / determinant
        ellipses[g, 0], ellipses[g, 1] = column, row
        ellipses[g, 2], ellipses[g, 3], ellipses[g, 4] = yy * per, -xy * per, xx * per
        ellipses[g, 5], ellipses[g, 9] = visible_opacity, z
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / length, dy / length, dz / length
        if turned and degree > 0:
            dx, dy, dz = _turned_back(quaternions[g], rest[g], dx, dy, dz)
        harmonic_values(degree, dx, dy, dz, values)
        for c in range(3):
            color = _HALF
            for h in range(sh.shape[1]):
                color += values[h] * sh[g, h, c]
            ellipses[g, 6 + c] = max(color, np.float32(0))


@compiled_fused
@no_type_check
def half_axis(axes, scale, i, view, slope_x, slope_y, per_z):
    """Project a Gaussian's axis `i` to the picture [px]; return it with the axis's depth [m]."""
    ax, ay, az = scale * axes[0, i], scale * axes[1, i], scale * axes[2, i]
    depth = view[6] * ax + view[7] * ay + view[8] * az
    px = (view[0] * ax + view[1] * ay + view[2] * az - slope_x * depth) * per_z
    py = (view[3] * ax + view[4] * ay + view[5] * az - slope_y * depth) * per_z
    return px, py, depth


@compiled_fused
@no_type_check
def covariance(half):
    """Compute the blurred 2D covariance of the projected half axes (xx, xy, yy), and its determinants before and after.

    Both determinants are sums of non-negative terms, since `xx * yy - xy * xy` loses all digits for needles.
    """
    xx = half[0, 0] * half[0, 0] + half[1, 0] * half[1, 0] + half[2, 0] * half[2, 0]
    xy = half[0, 0] * half[0, 1] + half[1, 0] * half[1, 1] + half[2, 0] * half[2, 1]
    yy = half[0, 1] * half[0, 1] + half[1, 1] * half[1, 1] + half[2, 1] * half[2, 1]
    c01, c02, c12 = cross(half, 0, 1), cross(half, 0, 2), cross(half, 1, 2)
    sharp = c01 * c01 + c02 * c02 + c12 * c12  # Cauchy-Binet
    return xx + _PIXEL, xy, yy + _PIXEL, sharp, sharp + _PIXEL * (xx + yy + _PIXEL)


@compiled_fused
@no_type_check
def cross(half, i, j):
    """Compute the signed area of the parallelogram of two projected axes [px²]."""
    return half[i, 0] * half[j, 1] - half[j, 0] * half[i, 1]


@compiled_fused
@no_type_check
def rotation_axes(q, axes):
    """Compute the rotation matrix of a unit quaternion; its columns are the Gaussian's axes."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    axes[0, 0], axes[1, 1] = _ONE - _TWO * (y * y + z * z), _ONE - _TWO * (x * x + z * z)
    axes[1, 0], axes[0, 1] = _TWO * (x * y + w * z), _TWO * (x * y - w * z)
    axes[2, 0], axes[0, 2] = _TWO * (x * z - w * y), _TWO * (x * z + w * y)
    axes[2, 1], axes[1, 2] = _TWO * (y * z + w * x), _TWO * (y * z - w * x)
    axes[2, 2] = _ONE - _TWO * (x * x + y * y)


@compiled_fused
@no_type_check
def _turned_back(now, rest, dx, dy, dz):
    """Rotate a direction by the inverse of now · rest⁻¹, to the frame of the Gaussian at rest."""
    w = now[0] * rest[0] + now[1] * rest[1] + now[2] * rest[2] + now[3] * rest[3]
    x = now[0] * rest[1] - now[1] * rest[0] + now[2] * rest[3] - now[3] * rest[2]
    y = now[0] * rest[2] - now[2] * rest[0] + now[3] * rest[1] - now[1] * rest[3]
    z = now[0] * rest[3] - now[3] * rest[0] + now[1] * rest[2] - now[2] * rest[1]
    cx, cy, cz = _TWO * (y * dz - z * dy), _TWO * (z * dx - x * dz), _TWO * (x * dy - y * dx)
    return dx + w * cx + y * cz - z * cy, dy + w * cy + z * cx - x * cz, dz + w * cz + x * cy - y * cx


@compiled_fused
@no_type_check
def list_tiles(nearest_first, bounds, columns, place, order, write):
    """Count, or list, each Gaussian in the tiles that its bounds overlap."""
    for i in range(len(nearest_first)):
        g = nearest_first[i]
        for row in range(bounds[g, 2] // TILE, (bounds[g, 3] - 1) // TILE + 1):
            for column in range(bounds[g, 0] // TILE, (bounds[g, 1] - 1) // TILE + 1):
                tile = row * columns + column
                if write:
                    order[place[tile]] = g
                place[tile] += 1


@compiled_fused
@no_type_check
def blend(first, end, ellipses, bounds, order, starts, picture):
    """Blend each tile front to back; the picture gets colour, depth and transmittance."""
    height, width = picture.shape[0], picture.shape[1]
    columns = -(-width // TILE)
    b = np.empty(5 * _SIZE, np.float32)  # red, green, blue, depth, transmittance
    for tile in range(first, end):
        left, top = tile % columns * TILE, tile // columns * TILE
        b[:] = 0
        for row in range(min(TILE, height - top)):
            for column in range(min(TILE, width - left)):
                b[4 * _SIZE + row * TILE + column] = 1
        for i in range(starts[tile], starts[tile + 1]):
            g = order[i]
            from_row, to_row = max(bounds[g, 2] - top, 0), min(bounds[g, 3] - top, TILE)
            _blend_one(ellipses[g], np.float32(left) + _HALF, np.float32(top) + _HALF, from_row, to_row, b)
            if i % 16 == 15 and is_opaque(b[_LIGHT:]):
                break
        for row in range(min(TILE, height - top)):
            for column in range(min(TILE, width - left)):
                for c in range(5):
                    picture[top + row, left + column, c] = b[c * _SIZE + row * TILE + column]


@compiled_fused
@no_type_check
def _blend_one(e, left, top, from_row, to_row, b):
    across, down, half_a, cross, half_c = left - e[0], top - e[1], _HALF * e[2], e[3], _HALF * e[4]
    opacity, red, green, blue, depth = e[5], e[6], e[7], e[8], e[9]
    for row in range(from_row, to_row):
        dy = down + np.float32(row)
        constant, slope = -half_c * dy * dy, -cross * dy
        start = np.uint32(row * TILE)
        for j in range(_LANES):
            dx = across + np.float32(j)
            alpha = min(opacity * falloff(constant + dx * (slope - half_a * dx)), _MAX)
            alpha = alpha if alpha >= _MIN else np.float32(0)
            contribution = alpha * b[_LIGHT + start + j]
            b[start + j] += contribution * red
            b[_GREEN + start + j] += contribution * green
            b[_BLUE + start + j] += contribution * blue
            b[_DEPTH + start + j] += contribution * depth
            b[_LIGHT + start + j] -= contribution


@compiled_fused
@no_type_check
def falloff(x):
    """Compute exp(x) for x in [-16, 0] by a polynomial of x / 16, squared four times; error 5e-5 for visible alpha."""
    y = max(x * _SIXTEENTH, -_ONE)
    p = ((((_EXP[0] * y + _EXP[1]) * y + _EXP[2]) * y + _EXP[3]) * y + _EXP[4]) * y + _EXP[5]
    p = p * p
    p = p * p
    p = p * p
    return p * p


@compiled_fused
@no_type_check
def is_opaque(light):
    """Whether a tile lets hardly any light through."""
    most = np.float32(0)
    for j in range(_SIZE):
        most = max(most, light[j])
    return most < _OPAQUE
