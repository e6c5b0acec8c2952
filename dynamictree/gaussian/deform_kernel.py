"""Kernels of `deform.Deformer`, written so that the compiler vectorizes them.

Each works on blocks: it gathers a block's inputs into one flat buffer, column by column, computes without branches, and
writes rows. Columns of the buffers are numbered in the order in which they are named. The last block is padded with the
last rows of `triangles` and `face_of`.
"""

from typing import no_type_check

import numpy as np

from dynamictree.gaussian.vector_rows import (
    LANES,
    gather_columns,
    interleave3,
    interleave4,
    scatter_columns,
    stream3,
    stream4,
)
from dynamictree.parallel import compiled_fused

BLOCK = 64  # rows per block; buffers of 41 columns fit into the L1 cache
MAX_STRETCH = 4.0
"""Largest factor by which a Gaussian's scale changes, whatever its face does."""
COLLAPSED = 1e-6
"""Ratio of area to the edges' squares below which a face is a line or a point."""

_B = BLOCK
_HALF, _ONE, _TWO = np.float32(0.5), np.float32(1), np.float32(2)
_LOW, _HIGH = np.float32(MAX_STRETCH**-2), np.float32(MAX_STRETCH**2)
_TINY = np.float32(1e-30)
_COLLAPSED = np.float32(COLLAPSED)

# products are fused with sums, without other fast-math flags: NaN and the order of sums are exact


@compiled_fused
@no_type_check
def turn_faces(first, end, rest, triangles, moved, out):
    """Compute each face's displacement (corner 0; 1 and 2 relative to it), rotation of the axes, and strain.

    rest: edges 01 and 02, quaternion of the axes, 1/L, X, 1/Y (see `deform.rest_frames`).
    """
    b = np.empty(22 * _B, np.float32)
    o = np.empty(16 * _B, np.float32)
    for block in range(first, end):
        start = block * _B
        for i in range(13 * _B):
            b[i] = rest[block, i]
        for j in range(_B):
            for corner in range(3):
                vertex = triangles[start + j, corner]
                for c in range(3):
                    b[(13 + 3 * corner + c) * _B + j] = moved[vertex, c]
        _turn_block(b, o)
        for j in range(_B):
            if o[12 * _B + j] != o[12 * _B + j]:  # NaN marks a collapsed face
                _turn_collapsed(b, o, j)
        for j in range(0, _B, LANES):
            scatter_columns(o, j, _B, out, start + j)


@compiled_fused
@no_type_check
def _turn_block(b, o):
    for j in range(_B):
        ux, uy, uz = b[13 * _B + j], b[14 * _B + j], b[15 * _B + j]
        dx1, dy1, dz1 = b[16 * _B + j] - ux, b[17 * _B + j] - uy, b[18 * _B + j] - uz
        dx2, dy2, dz2 = b[19 * _B + j] - ux, b[20 * _B + j] - uy, b[21 * _B + j] - uz
        x1, y1, z1 = b[j] + dx1, b[_B + j] + dy1, b[2 * _B + j] + dz1
        x2, y2, z2 = b[3 * _B + j] + dx2, b[4 * _B + j] + dy2, b[5 * _B + j] + dz2
        # current axes: t along edge 01, s across, n normal
        squares1, squares2 = x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2
        length = np.sqrt(squares1)
        nx, ny, nz = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
        area = np.sqrt(nx * nx + ny * ny + nz * nz)
        per_length, per_area = _ONE / max(length, _TINY), _ONE / max(area, _TINY)
        tx, ty, tz = x1 * per_length, y1 * per_length, z1 * per_length
        nx, ny, nz = nx * per_area, ny * per_area, nz * per_area
        sx, sy, sz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
        # deformation gradient in the plane, A = [[a00, a01], [0, a11]], maps (L, 0) and (X, Y) to current positions
        a00 = length * b[10 * _B + j]
        a01 = (x2 * tx + y2 * ty + z2 * tz - a00 * b[11 * _B + j]) * b[12 * _B + j]
        a11 = area * per_length * b[12 * _B + j]
        # rotation of its polar decomposition, within the plane of t and s
        cosine, sine = a00 + a11, -a01
        per_both = _ONE / max(np.sqrt(cosine * cosine + sine * sine), _TINY)
        cosine, sine = cosine * per_both, sine * per_both
        ax, ay, az = cosine * tx + sine * sx, cosine * ty + sine * sy, cosine * tz + sine * sz
        bx, by, bz = cosine * sx - sine * tx, cosine * sy - sine * ty, cosine * sz - sine * tz
        # quaternion of the axes [a b n]: Shepperd's four cases, all computed, one chosen
        w2, x22 = _ONE + ax + by + nz, _ONE + ax - by - nz
        y22, z22 = _ONE - ax + by - nz, _ONE - ax - by + nz
        wx, wy, wz = bz - ny, nx - az, ay - bx
        xy, xz, yz = ay + bx, az + nx, bz + ny
        best = max(w2, x22, y22, z22)
        by_w, by_x, by_y = w2 == best, x22 == best, y22 == best
        qw = w2 if by_w else (wx if by_x else (wy if by_y else wz))
        qx = wx if by_w else (x22 if by_x else (xy if by_y else xz))
        qy = wy if by_w else (xy if by_x else (y22 if by_y else yz))
        qz = wz if by_w else (xz if by_x else (yz if by_y else z22))
        per_norm = _HALF / np.sqrt(max(best, _TINY))
        # choose q or -q, the nearer to rest, so that motions have no jumps
        along = qw * b[6 * _B + j] + qx * b[7 * _B + j] + qy * b[8 * _B + j] + qz * b[9 * _B + j]
        per_norm = per_norm if along >= 0 else -per_norm
        collapsed = area <= _COLLAPSED * (squares1 + squares2)
        o[j], o[_B + j], o[2 * _B + j] = ux, uy, uz
        o[3 * _B + j], o[4 * _B + j], o[5 * _B + j] = dx1, dy1, dz1
        o[6 * _B + j], o[7 * _B + j], o[8 * _B + j] = dx2, dy2, dz2
        o[9 * _B + j], o[10 * _B + j], o[11 * _B + j] = qw * per_norm, qx * per_norm, qy * per_norm
        o[12 * _B + j] = np.float32(np.nan) if collapsed else qz * per_norm
        # AᵀA - 1: relative growth of squared lengths in the plane
        o[13 * _B + j] = a00 * a00 - _ONE
        o[14 * _B + j] = _TWO * a00 * a01
        o[15 * _B + j] = a01 * a01 + a11 * a11 - _ONE


@compiled_fused
@no_type_check
def _turn_collapsed(b, o, j):
    """Rotate a collapsed face's axes by the shortest arc that maps its longer edge to its current direction."""
    before, after = np.empty(3, np.float32), np.empty(3, np.float32)
    longest = np.float32(0)
    for edge in range(2):
        squares = np.float32(0)
        for c in range(3):
            value = b[(3 * edge + c) * _B + j] + o[(3 + 3 * edge + c) * _B + j]
            squares += value * value
        if squares > longest:
            longest = squares
            for c in range(3):
                before[c] = b[(3 * edge + c) * _B + j]
                after[c] = before[c] + o[(3 + 3 * edge + c) * _B + j]
    w, x, y, z = _ONE, np.float32(0), np.float32(0), np.float32(0)
    if longest > 0:
        per_both = _ONE / np.sqrt(longest * (before[0] ** 2 + before[1] ** 2 + before[2] ** 2))
        w += (before[0] * after[0] + before[1] * after[1] + before[2] * after[2]) * per_both
        x = (before[1] * after[2] - before[2] * after[1]) * per_both
        y = (before[2] * after[0] - before[0] * after[2]) * per_both
        z = (before[0] * after[1] - before[1] * after[0]) * per_both
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    if norm < _COLLAPSED:
        w, x, y, z, norm = _ONE, np.float32(0), np.float32(0), np.float32(0), _ONE
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    rw, rx, ry, rz = b[6 * _B + j], b[7 * _B + j], b[8 * _B + j], b[9 * _B + j]
    o[9 * _B + j] = w * rw - x * rx - y * ry - z * rz
    o[10 * _B + j] = w * rx + x * rw + y * rz - z * ry
    o[11 * _B + j] = w * ry - x * rz + y * rw + z * rx
    o[12 * _B + j] = w * rz + x * ry - y * rx + z * rw


@compiled_fused
@no_type_check
def turn_gaussians(first, end, rest, face_of, faces, means, quaternions, scales, streamed):
    """Compute each Gaussian's mean, quaternion and scales, in flat arrays.

    With `streamed`, the arrays are aligned to cache lines and written past the caches, which would read them first.

    rest: weights 1 and 2, offset in the face's axes, point on the face, quaternion from the face's axes, scales.
    """
    num_gaussians = len(means) // 3
    b = np.empty(31 * _B, np.float32)
    o = np.empty(10 * _B, np.float32)
    for block in range(first, end):
        start = block * _B
        count = min(_B, num_gaussians - start)
        for i in range(15 * _B):
            b[i] = rest[block, i]
        for j in range(0, _B, LANES):
            gather_columns(faces, face_of, start + j, b, 15 * _B + j, _B)
        for j in range(_B):
            w1, w2 = b[j], b[_B + j]
            dx, dy, dz = b[2 * _B + j], b[3 * _B + j], b[4 * _B + j]
            qw, qx, qy, qz = b[24 * _B + j], b[25 * _B + j], b[26 * _B + j], b[27 * _B + j]
            cx, cy, cz = _TWO * (qy * dz - qz * dy), _TWO * (qz * dx - qx * dz), _TWO * (qx * dy - qy * dx)
            # point + displacement of the point + rotated offset
            o[j] = b[5 * _B + j] + (
                b[15 * _B + j] + w1 * b[18 * _B + j] + w2 * b[21 * _B + j] + dx + qw * cx + qy * cz - qz * cy
            )
            o[_B + j] = b[6 * _B + j] + (
                b[16 * _B + j] + w1 * b[19 * _B + j] + w2 * b[22 * _B + j] + dy + qw * cy + qz * cx - qx * cz
            )
            o[2 * _B + j] = b[7 * _B + j] + (
                b[17 * _B + j] + w1 * b[20 * _B + j] + w2 * b[23 * _B + j] + dz + qw * cz + qx * cy - qy * cx
            )
            w, x, y, z = b[8 * _B + j], b[9 * _B + j], b[10 * _B + j], b[11 * _B + j]
            o[3 * _B + j] = qw * w - qx * x - qy * y - qz * z
            o[4 * _B + j] = qw * x + qx * w + qy * z - qz * y
            o[5 * _B + j] = qw * y - qx * z + qy * w + qz * x
            o[6 * _B + j] = qw * z + qx * y - qy * x + qz * w
            # components p, s of the Gaussian's axes along the face's t, s; |F e|² = 1 + (p, s)·(AᵀA - 1)·(p, s)
            xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
            p0, p1, p2 = _ONE - _TWO * (yy + zz), _TWO * (xy - wz), _TWO * (xz + wy)
            s0, s1, s2 = _TWO * (xy + wz), _ONE - _TWO * (xx + zz), _TWO * (yz - wx)
            e0, e1, e2 = b[28 * _B + j], b[29 * _B + j], b[30 * _B + j]
            c0 = _ONE + p0 * (e0 * p0 + e1 * s0) + e2 * s0 * s0
            c1 = _ONE + p1 * (e0 * p1 + e1 * s1) + e2 * s1 * s1
            c2 = _ONE + p2 * (e0 * p2 + e1 * s2) + e2 * s2 * s2
            o[7 * _B + j] = b[12 * _B + j] * np.sqrt(min(max(c0, _LOW), _HIGH))
            o[8 * _B + j] = b[13 * _B + j] * np.sqrt(min(max(c1, _LOW), _HIGH))
            o[9 * _B + j] = b[14 * _B + j] * np.sqrt(min(max(c2, _LOW), _HIGH))
        if count < _B:
            for j in range(count):
                for k in range(3):
                    means[3 * (start + j) + k] = o[k * _B + j]
                    scales[3 * (start + j) + k] = o[(7 + k) * _B + j]
                for k in range(4):
                    quaternions[4 * (start + j) + k] = o[(3 + k) * _B + j]
        elif streamed:
            for j in range(0, _B, LANES):
                stream3(o, j, _B, means, 3 * (start + j))
                stream4(o, 3 * _B + j, _B, quaternions, 4 * (start + j))
                stream3(o, 7 * _B + j, _B, scales, 3 * (start + j))
        else:
            for j in range(0, _B, LANES):
                interleave3(o, j, _B, means, 3 * (start + j))
                interleave4(o, 3 * _B + j, _B, quaternions, 4 * (start + j))
                interleave3(o, 7 * _B + j, _B, scales, 3 * (start + j))
