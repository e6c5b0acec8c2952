"""Kernels of `gradient`: propagate the gradient of a picture back to the Gaussians that were blended into it.

The reverse of `rasterize_kernel`. Each tile walks its list front to back a second time: the light from behind a
Gaussian is the finished pixel minus the part blended before, so the forward pass need only store its picture.
"""

from typing import no_type_check

import numpy as np

from dynamictree.gaussian.harmonics import SH_CONSTANTS
from dynamictree.gaussian.rasterize_kernel import (
    MAX_ALPHA,
    MIN_ALPHA,
    TILE,
    covariance,
    cross,
    falloff,
    half_axis,
    is_opaque,
    rotation_axes,
)
from dynamictree.gaussian.turn import harmonic_values
from dynamictree.parallel import compiled_reordered

ENTRY = 10
"""Number of gradients per Gaussian and tile: centre (2), conic (3), drawn opacity, colour (3), depth."""

_HALF, _ONE, _TWO, _ZERO = np.float32(0.5), np.float32(1), np.float32(2), np.float32(0)
_MIN, _MAX = np.float32(MIN_ALPHA), np.float32(MAX_ALPHA)
_SIZE = TILE * TILE
# unsigned: indices cannot wrap around, so LLVM vectorizes the loop
_LANES = np.uint32(TILE)
_TO_COME, _RED, _GREEN, _BLUE, _DEPTH = (np.uint32(plane * _SIZE) for plane in range(1, 6))
_SH = tuple(np.float32(constant) for constant in SH_CONSTANTS[1:5])
_FOUR = np.float32(4)


@compiled_reordered
@no_type_check
def blend_back(first, end, ellipses, bounds, order, starts, picture, gradient, entries):
    """Compute each listed Gaussian's gradients per tile from a picture (colour, depth, light left) and its gradient."""
    height, width = picture.shape[0], picture.shape[1]
    columns = -(-width // TILE)
    b = np.empty(6 * _SIZE, np.float32)  # light left, value behind, gradients of red, green, blue, depth
    for tile in range(first, end):
        left, top = tile % columns * TILE, tile // columns * TILE
        b[:] = 0
        for row in range(min(TILE, height - top)):
            for column in range(min(TILE, width - left)):
                to_come = _ZERO
                place = row * TILE + column
                for c in range(5):
                    to_come += picture[top + row, left + column, c] * gradient[top + row, left + column, c]
                for c in range(4):
                    b[(2 + c) * _SIZE + place] = gradient[top + row, left + column, c]
                b[place], b[_SIZE + place] = _ONE, to_come
        for i in range(starts[tile], starts[tile + 1]):
            g = order[i]
            from_row, to_row = max(bounds[g, 2] - top, 0), min(bounds[g, 3] - top, TILE)
            _one_back(ellipses[g], np.float32(left) + _HALF, np.float32(top) + _HALF, from_row, to_row, b, entries[i])
            if i % 16 == 15 and is_opaque(b):
                break


@compiled_reordered
@no_type_check
def _one_back(e, left, top, from_row, to_row, b, out):
    across, down, half_a, cross, half_c = left - e[0], top - e[1], _HALF * e[2], e[3], _HALF * e[4]
    opacity, red, green, blue, depth = e[5], e[6], e[7], e[8], e[9]
    sum_h, sum_x, sum_y, sum_xx, sum_xy, sum_yy = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    sum_r, sum_g, sum_b, sum_d = _ZERO, _ZERO, _ZERO, _ZERO
    for row in range(from_row, to_row):
        dy = down + np.float32(row)
        constant, slope = -half_c * dy * dy, -cross * dy
        start = np.uint32(row * TILE)
        h0, h1, h2 = _ZERO, _ZERO, _ZERO
        for j in range(_LANES):
            dx = across + np.float32(j)
            whole = opacity * falloff(constant + dx * (slope - half_a * dx))
            alpha = min(whole, _MAX)
            alpha = alpha if alpha >= _MIN else _ZERO
            light = b[start + j]
            red_g, green_g = b[_RED + start + j], b[_GREEN + start + j]
            blue_g, depth_g = b[_BLUE + start + j], b[_DEPTH + start + j]
            value = red * red_g + green * green_g + blue * blue_g + depth * depth_g
            weight = alpha * light
            behind = b[_TO_COME + start + j] - weight * value
            b[_TO_COME + start + j] = behind
            b[start + j] = light - weight
            h = weight * value - behind * alpha / (_ONE - alpha)  # d/d ln(alpha)
            h = h if whole < _MAX else _ZERO
            h0 += h
            h1 += h * dx
            h2 += h * dx * dx
            sum_r += weight * red_g
            sum_g += weight * green_g
            sum_b += weight * blue_g
            sum_d += weight * depth_g
        sum_h += h0
        sum_x += h1
        sum_xx += h2
        sum_y += h0 * dy
        sum_xy += h1 * dy
        sum_yy += h0 * dy * dy
    out[0], out[1] = e[2] * sum_x + e[3] * sum_y, e[3] * sum_x + e[4] * sum_y
    out[2], out[3], out[4] = -_HALF * sum_xx, -sum_xy, -_HALF * sum_yy
    out[5] = sum_h / opacity
    out[6], out[7], out[8], out[9] = sum_r, sum_g, sum_b, sum_d


@compiled_reordered
@no_type_check
def gather(order, entries, gradients):
    """Sum each Gaussian's gradients over its tiles, in an order that does not depend on the number of threads."""
    for i in range(len(order)):
        g = order[i]
        for c in range(ENTRY):
            gradients[g, c] += entries[i, c]


@compiled_reordered
@no_type_check
def project_back(first, end, means, quaternions, scales, opacity, sh, view, bounds, ellipses, gradients, out):
    """Turn gradients of ellipses into those of mean, quaternion, ln scale, logit opacity (11 numbers), harmonics."""
    degree = round(np.sqrt(sh.shape[1])) - 1
    values, slopes = np.empty(9, np.float32), np.zeros((9, 3), np.float32)
    axes, axes_g = np.empty((3, 3), np.float32), np.empty((3, 3), np.float32)
    half, half_g = np.empty((3, 2), np.float32), np.empty((3, 2), np.float32)
    depth = np.empty(3, np.float32)
    for g in range(first, end):
        if bounds[g, 1] <= bounds[g, 0]:
            continue
        e_g = gradients[g]
        dx, dy, dz = means[g, 0] - view[9], means[g, 1] - view[10], means[g, 2] - view[11]
        x = view[0] * dx + view[1] * dy + view[2] * dz
        y = view[3] * dx + view[4] * dy + view[5] * dz
        z = view[6] * dx + view[7] * dy + view[8] * dz
        rotation_axes(quaternions[g], axes)
        per_z = view[12] / z
        slope_x, slope_y = min(max(x / z, -view[17]), view[17]), min(max(y / z, -view[18]), view[18])
        for i in range(3):
            half[i, 0], half[i, 1], depth[i] = half_axis(axes, scales[g, i], i, view, slope_x, slope_y, per_z)
        xx, xy, yy, sharp, whole = covariance(half)
        # conic = inverse of the blurred covariance: dΣ = −Q dQ Q
        a, b, c = yy / whole, -xy / whole, xx / whole
        ga, gb, gc = e_g[2], _HALF * e_g[3], e_g[4]
        m00, m01 = a * ga + b * gb, a * gb + b * gc
        m10, m11 = b * ga + c * gb, b * gb + c * gc
        xx_g, yy_g = -(m00 * a + m01 * b), -(m10 * b + m11 * c)
        xy_g = -(m00 * b + m01 * c) - (m10 * a + m11 * b)
        filtered_opacity = ellipses[g, 5]
        share = _HALF * e_g[5] * filtered_opacity  # drawn opacity = opacity · sqrt(sharp / whole)
        xx_g -= share * a
        yy_g -= share * c
        xy_g += share * _TWO * xy / whole
        by_sharp = _TWO * share / sharp
        for i in range(3):
            half_g[i, 0] = _TWO * xx_g * half[i, 0] + xy_g * half[i, 1]
            half_g[i, 1] = _TWO * yy_g * half[i, 1] + xy_g * half[i, 0]
            for j in range(3):
                area = by_sharp * cross(half, i, j)
                half_g[i, 0] += area * half[j, 1]
                half_g[i, 1] -= area * half[j, 0]
        out[g, 10] += e_g[5] * filtered_opacity * (_ONE - opacity[g])  # derivative by the logit
        per_z_g = e_g[0] * x + e_g[1] * y
        x_g, y_g, z_g = e_g[0] * per_z, e_g[1] * per_z, e_g[9]
        slope_x_g, slope_y_g = _ZERO, _ZERO
        for i in range(3):
            px_g, py_g, w = half_g[i, 0], half_g[i, 1], depth[i]
            per_z_g += (px_g * half[i, 0] + py_g * half[i, 1]) / per_z
            u_g, v_g = px_g * per_z, py_g * per_z
            w_g = -u_g * slope_x - v_g * slope_y
            slope_x_g, slope_y_g = slope_x_g - u_g * w, slope_y_g - v_g * w
            along = _ZERO
            for k in range(3):
                axis_g = view[k] * u_g + view[3 + k] * v_g + view[6 + k] * w_g
                axes_g[k, i] = axis_g * scales[g, i]
                along += axis_g * axes[k, i]
            out[g, 7 + i] += along * scales[g, i]  # derivative by the logarithm
        z_g -= per_z_g * per_z / z
        if slope_x == x / z:
            x_g, z_g = x_g + slope_x_g / z, z_g - slope_x_g * slope_x / z
        if slope_y == y / z:
            y_g, z_g = y_g + slope_y_g / z, z_g - slope_y_g * slope_y / z
        _rotation_back(quaternions[g], axes_g, out[g])
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / length, dy / length, dz / length
        harmonic_values(degree, dx, dy, dz, values)
        harmonic_slopes(degree, dx, dy, dz, slopes)
        tx, ty, tz = _ZERO, _ZERO, _ZERO
        for k in range(3):
            color_g = e_g[6 + k] if ellipses[g, 6 + k] > _ZERO else _ZERO
            for h in range(sh.shape[1]):
                out[g, 11 + 3 * h + k] += color_g * values[h]
                strength = color_g * sh[g, h, k]
                tx, ty, tz = tx + strength * slopes[h, 0], ty + strength * slopes[h, 1], tz + strength * slopes[h, 2]
        outward = tx * dx + ty * dy + tz * dz
        for k in range(3):
            out[g, k] += view[k] * x_g + view[3 + k] * y_g + view[6 + k] * z_g
        out[g, 0] += (tx - outward * dx) / length
        out[g, 1] += (ty - outward * dy) / length
        out[g, 2] += (tz - outward * dz) / length


@compiled_reordered
@no_type_check
def _rotation_back(q, m, out):
    """Add the gradient of a quaternion that is normalized before use, so the gradient is orthogonal to it."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    w_g = _TWO * (x * (m[2, 1] - m[1, 2]) + y * (m[0, 2] - m[2, 0]) + z * (m[1, 0] - m[0, 1]))
    x_g = _TWO * (y * (m[1, 0] + m[0, 1]) + z * (m[2, 0] + m[0, 2]) + w * (m[2, 1] - m[1, 2]))
    y_g = _TWO * (x * (m[1, 0] + m[0, 1]) + z * (m[2, 1] + m[1, 2]) + w * (m[0, 2] - m[2, 0]))
    z_g = _TWO * (x * (m[2, 0] + m[0, 2]) + y * (m[2, 1] + m[1, 2]) + w * (m[1, 0] - m[0, 1]))
    x_g -= _FOUR * x * (m[1, 1] + m[2, 2])
    y_g -= _FOUR * y * (m[0, 0] + m[2, 2])
    z_g -= _FOUR * z * (m[0, 0] + m[1, 1])
    along = w_g * w + x_g * x + y_g * y + z_g * z
    out[3] += w_g - along * w
    out[4] += x_g - along * x
    out[5] += y_g - along * y
    out[6] += z_g - along * z


@compiled_reordered
@no_type_check
def harmonic_slopes(degree, x, y, z, out):
    """Derivatives of `turn.harmonic_values` by x, y and z, up to degree 2, the highest that is optimised."""
    if degree >= 1:
        out[1, 1], out[2, 2], out[3, 0] = -_SH[0], _SH[0], -_SH[0]
    if degree >= 2:
        out[4, 0], out[4, 1] = _SH[1] * y, _SH[1] * x
        out[5, 1], out[5, 2] = -_SH[1] * z, -_SH[1] * y
        out[6, 0], out[6, 1], out[6, 2] = -_TWO * _SH[2] * x, -_TWO * _SH[2] * y, _FOUR * _SH[2] * z
        out[7, 0], out[7, 2] = -_SH[1] * z, -_SH[1] * x
        out[8, 0], out[8, 1] = _TWO * _SH[3] * x, -_TWO * _SH[3] * y
