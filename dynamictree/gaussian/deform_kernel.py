"""Kernels of `deform.Deformer`: current state of each face, and from it the pose of each Gaussian."""

from typing import no_type_check

import numpy as np

from dynamictree.parallel import compiled_fused

FACE_COLUMNS = 16  # state of a face: three displacements, quaternion of the axes, strain
MAX_STRETCH = 4.0
"""Largest factor by which a Gaussian's scale changes, whatever its face does."""
COLLAPSED = 1e-6
"""Ratio of area to the edges' squares below which a face is a line or a point."""

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
    for f in range(first, end):
        for c in range(3):
            out[f, c] = moved[triangles[f, 0], c]
            out[f, 3 + c] = moved[triangles[f, 1], c] - out[f, c]
            out[f, 6 + c] = moved[triangles[f, 2], c] - out[f, c]
        x1, y1, z1 = rest[f, 0] + out[f, 3], rest[f, 1] + out[f, 4], rest[f, 2] + out[f, 5]
        x2, y2, z2 = rest[f, 3] + out[f, 6], rest[f, 4] + out[f, 7], rest[f, 5] + out[f, 8]
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
        a00 = length * rest[f, 10]
        a01 = (x2 * tx + y2 * ty + z2 * tz - a00 * rest[f, 11]) * rest[f, 12]
        a11 = area * per_length * rest[f, 12]
        # AᵀA - 1: relative growth of squared lengths in the plane
        out[f, 13] = a00 * a00 - _ONE
        out[f, 14] = _TWO * a00 * a01
        out[f, 15] = a01 * a01 + a11 * a11 - _ONE
        quaternion = rest[f, 6], rest[f, 7], rest[f, 8], rest[f, 9]
        if area <= _COLLAPSED * (squares1 + squares2):
            edge, now, square = (0, (x1, y1, z1), squares1) if squares1 >= squares2 else (3, (x2, y2, z2), squares2)
            arc = _shortest_arc((rest[f, edge], rest[f, edge + 1], rest[f, edge + 2]), now, square)
            out[f, 9], out[f, 10], out[f, 11], out[f, 12] = _product(arc, quaternion)
            continue
        # rotation of its polar decomposition, within the plane of t and s
        cosine, sine = a00 + a11, -a01
        per_both = _ONE / max(np.sqrt(cosine * cosine + sine * sine), _TINY)
        cosine, sine = cosine * per_both, sine * per_both
        ax, ay, az = cosine * tx + sine * sx, cosine * ty + sine * sy, cosine * tz + sine * sz
        bx, by, bz = cosine * sx - sine * tx, cosine * sy - sine * ty, cosine * sz - sine * tz
        # quaternion of the axes [a b n]: the one of Shepperd's four cases that divides by most
        w2, x22 = _ONE + ax + by + nz, _ONE + ax - by - nz
        y22, z22 = _ONE - ax + by - nz, _ONE - ax - by + nz
        best = max(w2, x22, y22, z22)
        if w2 == best:
            q = w2, bz - ny, nx - az, ay - bx
        elif x22 == best:
            q = bz - ny, x22, ay + bx, az + nx
        elif y22 == best:
            q = nx - az, ay + bx, y22, bz + ny
        else:
            q = ay - bx, az + nx, bz + ny, z22
        # choose q or -q, the nearer to rest, so that motions have no jumps
        along = q[0] * quaternion[0] + q[1] * quaternion[1] + q[2] * quaternion[2] + q[3] * quaternion[3]
        per_norm = (_HALF if along >= 0 else -_HALF) / np.sqrt(max(best, _TINY))
        for c in range(4):
            out[f, 9 + c] = q[c] * per_norm


@compiled_fused
@no_type_check
def _shortest_arc(before, after, square):
    """Quaternion of the shortest arc from a vector to another, whose squared length is given; 1 if there is none."""
    w, x, y, z = _ONE, np.float32(0), np.float32(0), np.float32(0)
    if square > 0:
        per_both = _ONE / np.sqrt(square * (before[0] ** 2 + before[1] ** 2 + before[2] ** 2))
        w += (before[0] * after[0] + before[1] * after[1] + before[2] * after[2]) * per_both
        x = (before[1] * after[2] - before[2] * after[1]) * per_both
        y = (before[2] * after[0] - before[0] * after[2]) * per_both
        z = (before[0] * after[1] - before[1] * after[0]) * per_both
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    if norm < _COLLAPSED:
        return _ONE, np.float32(0), np.float32(0), np.float32(0)
    return w / norm, x / norm, y / norm, z / norm


@compiled_fused
@no_type_check
def _product(a, b):
    """Product of two quaternions w, x, y, z."""
    (qw, qx, qy, qz), (w, x, y, z) = a, b
    return (
        qw * w - qx * x - qy * y - qz * z,
        qw * x + qx * w + qy * z - qz * y,
        qw * y - qx * z + qy * w + qz * x,
        qw * z + qx * y - qy * x + qz * w,
    )


@compiled_fused
@no_type_check
def turn_gaussians(first, end, rest, face_of, faces, means, quaternions, scales):
    """Compute each Gaussian's mean, quaternion and scales.

    rest: weights 1 and 2, offset in the face's axes, point on the face, quaternion from the face's axes, scales.
    """
    for g in range(first, end):
        face, row = faces[face_of[g]], rest[g]
        dx, dy, dz = row[2], row[3], row[4]
        qw, qx, qy, qz = face[9], face[10], face[11], face[12]
        cx, cy, cz = _TWO * (qy * dz - qz * dy), _TWO * (qz * dx - qx * dz), _TWO * (qx * dy - qy * dx)
        turned = dx + qw * cx + qy * cz - qz * cy, dy + qw * cy + qz * cx - qx * cz, dz + qw * cz + qx * cy - qy * cx
        for c in range(3):  # point + displacement of the point + rotated offset
            means[g, c] = row[5 + c] + (face[c] + row[0] * face[3 + c] + row[1] * face[6 + c] + turned[c])
        w, x, y, z = row[8], row[9], row[10], row[11]
        quaternions[g, 0], quaternions[g, 1], quaternions[g, 2], quaternions[g, 3] = _product(
            (qw, qx, qy, qz), (w, x, y, z)
        )
        # components p, s of the Gaussian's axes along the face's t, s; |F e|² = 1 + (p, s)·(AᵀA - 1)·(p, s)
        p = _ONE - _TWO * (y * y + z * z), _TWO * (x * y - w * z), _TWO * (x * z + w * y)
        s = _TWO * (x * y + w * z), _ONE - _TWO * (x * x + z * z), _TWO * (y * z - w * x)
        for c in range(3):
            growth = _ONE + p[c] * (face[13] * p[c] + face[14] * s[c]) + face[15] * s[c] * s[c]
            scales[g, c] = row[12 + c] * np.sqrt(min(max(growth, _LOW), _HIGH))
