"""Rasterise faces with a z-buffer over homogeneous triangles, without clipping.

A triangle's corners a, b, c in homogeneous picture coordinates form a matrix; its inverse maps a sample (x, y, 1) to
barycentric coordinates over depth. The sample is inside if all three are positive, also for triangles that extend
behind the camera (Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997).
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32

from dynamictree.parallel import compiled, in_bands
from dynamictree.render.appearance import Appearance, alpha_at


class ScreenTriangles(NamedTuple):
    """Faces prepared for the loop over samples."""

    barycentric: Float64[np.ndarray, "F 9"]  # rows of the inverse matrix, which maps (x, y, 1)
    bounds: Int32[np.ndarray, "F 4"]  # first and end column, first and end row; empty if not visible
    level: Int32[np.ndarray, " F"]  # mip level of the texture, 0 is full size


class Visible(NamedTuple):
    """Contents of the z-buffer."""

    nearness: Float32[np.ndarray, "H W"]  # nearest surface's 1 / depth, or minus the depth in a parallel projection
    face: Int32[np.ndarray, "H W"]  # -1 without a face


def screen_triangles(
    homogeneous: Float64[np.ndarray, "N 3"],
    faces: Int32[np.ndarray, "F 3"],
    appearance: Appearance,
    *,
    width: int,
    height: int,
) -> ScreenTriangles:
    """Prepare faces with corners (x w, y w, w), x and y in samples; w = 1 in a parallel projection."""
    triangles = ScreenTriangles(
        barycentric=np.zeros((len(faces), 9)),
        bounds=np.zeros((len(faces), 4), np.int32),
        level=np.zeros(len(faces), np.int32),
    )
    in_bands(_prepare_faces, len(faces), homogeneous, faces, appearance, width, height, triangles)
    return triangles


def rasterise(
    triangles: ScreenTriangles,
    faces: Int32[np.ndarray, "F 3"],
    nearness: Float32[np.ndarray, " N"],
    appearance: Appearance,
    *,
    width: int,
    height: int,
) -> Visible:
    """Find the nearest face at every sample, the first if several are equally near.

    The vertices' nearness, 1 in perspective or minus the depth, is interpolated by the barycentric coordinates.
    """
    visible = Visible(np.full((height, width), -np.inf, np.float32), np.full((height, width), -1, np.int32))
    in_bands(_raster_rows, height, triangles, faces, nearness, appearance, visible)
    return visible


@compiled
@no_type_check
def _prepare_faces(first, end, homogeneous, faces, appearance, width, height, triangles):
    for f in range(first, end):
        i, j, k = faces[f]
        ax, ay, aw = homogeneous[i]
        bx, by, bw = homogeneous[j]
        cx, cy, cw = homogeneous[k]
        if aw <= 0 and bw <= 0 and cw <= 0:
            continue
        p0, p1, p2 = by * cw - bw * cy, bw * cx - bx * cw, bx * cy - by * cx
        q0, q1, q2 = cy * aw - cw * ay, cw * ax - cx * aw, cx * ay - cy * ax
        r0, r1, r2 = ay * bw - aw * by, aw * bx - ax * bw, ax * by - ay * bx
        determinant = ax * p0 + ay * p1 + aw * p2
        if determinant == 0:
            continue
        scale = 1 / determinant
        row = triangles.barycentric[f]
        row[0], row[1], row[2] = p0 * scale, p1 * scale, p2 * scale
        row[3], row[4], row[5] = q0 * scale, q1 * scale, q2 * scale
        row[6], row[7], row[8] = r0 * scale, r1 * scale, r2 * scale
        left, right, top, bottom = 0.0, float(width), 0.0, float(height)
        if aw > 0 and bw > 0 and cw > 0:
            xs, ys = (ax / aw, bx / bw, cx / cw), (ay / aw, by / bw, cy / cw)
            left, right = max(left, min(xs)), min(right, max(xs))
            top, bottom = max(top, min(ys)), min(bottom, max(ys))
            twice_area = abs(determinant / (aw * bw * cw))
            triangles.level[f] = _texture_level(appearance, faces[f], appearance.face_material[f], twice_area)
        if left <= right and top <= bottom:
            bounds = triangles.bounds[f]
            bounds[0], bounds[1] = int(np.ceil(left - 0.5)), int(np.floor(right - 0.5)) + 1
            bounds[2], bounds[3] = int(np.ceil(top - 0.5)), int(np.floor(bottom - 0.5)) + 1
            bounds[1], bounds[3] = min(bounds[1], width), min(bounds[3], height)


@compiled
@no_type_check
def _texture_level(appearance, corners, material, twice_area):
    levels = appearance.texture_levels[material]
    if levels[0, 1] == 0:
        return 0
    ua, va = appearance.uv[corners[0]]
    ub, vb = appearance.uv[corners[1]]
    uc, vc = appearance.uv[corners[2]]
    texels = abs((ub - ua) * (vc - va) - (uc - ua) * (vb - va)) * levels[0, 1] * levels[0, 2]
    level = 0
    # each level has a quarter of the texels; stop at about one texel per sample
    while level + 1 < len(levels) and levels[level + 1, 1] > 0 and texels > 2 * twice_area:
        texels /= 4
        level += 1
    return level


@compiled
@no_type_check
def _raster_rows(first, end, triangles, faces, nearness, appearance, visible):
    for f in range(len(faces)):
        left, right, top, bottom = triangles.bounds[f]
        top, bottom = max(top, first), min(bottom, end)
        if left >= right or top >= bottom:
            continue
        m = triangles.barycentric[f]
        material = appearance.face_material[f]
        cutoff = appearance.cutoff[material]
        na, nb, nc = nearness[faces[f, 0]], nearness[faces[f, 1]], nearness[faces[f, 2]]
        for row in range(top, bottom):
            y = row + 0.5
            a0, b0, c0 = m[1] * y + m[2], m[4] * y + m[5], m[7] * y + m[8]
            for column in range(left, right):
                x = column + 0.5
                a, b, c = m[0] * x + a0, m[3] * x + b0, m[6] * x + c0
                if a < 0 or b < 0 or c < 0:
                    continue
                near = np.float32(a * na + b * nb + c * nc)
                if near <= visible.nearness[row, column]:
                    continue
                if cutoff > 0 and alpha_at(appearance, faces[f], material, triangles.level[f], (a, b, c)) < cutoff:
                    continue
                visible.nearness[row, column] = near
                visible.face[row, column] = f
