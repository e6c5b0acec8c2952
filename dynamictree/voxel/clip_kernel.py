"""Clip triangles to a grid, and compute the exact area of each in each voxel.

A triangle is cut into slabs along x, each slab's polygon along y, each of those along z. The range of the next cut is
that of the current polygon, so only voxels that the triangle meets are visited. A corner is six numbers: its position
in voxels and its barycentric coordinates, which are interpolated with it and so stay exact on needles.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64

from dynamictree.parallel import compiled

_X, _Y, _Z = np.int64(0), np.int64(1), np.int64(2)  # typed, so that one compilation serves all three


@dataclass(frozen=True, kw_only=True)
class SurfacePieces:
    """Pieces of faces, one per voxel that a face meets, in the order of faces."""

    keys: Int64[np.ndarray, " P"]  # key of the voxel, (x R + y) R + z
    faces: Int32[np.ndarray, " P"]
    areas: Float64[np.ndarray, " P"]  # [voxels²]; 0 if the face only touches the voxel
    centroids: Float32[np.ndarray, "P 3"]  # barycentric coordinates in the face


def cut_faces(corners: Float64[np.ndarray, "F 3 3"], resolution: int) -> SurfacePieces:
    """Cut triangles with corners in voxels, within 0 to `resolution`."""
    counts = np.zeros(len(corners), np.int64)
    nothing = (np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0), np.zeros((0, 3), np.float32))
    _cut_all(corners, resolution, counts, counts, False, *nothing)
    ends = np.cumsum(counts)
    total = int(ends[-1])
    keys, faces = np.empty(total, np.int64), np.empty(total, np.int32)
    areas, centroids = np.empty(total), np.empty((total, 3), np.float32)
    _cut_all(corners, resolution, counts, ends - counts, True, keys, faces, areas, centroids)
    return SurfacePieces(keys=keys, faces=faces, areas=areas, centroids=centroids)


@compiled
@no_type_check
def _cut(polygon, count, axis, bound, sign, out):
    """Clip a polygon to sign * (x - bound) >= 0 (Sutherland-Hodgman 1974); return the number of corners left."""
    num_left = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        distance = sign * (polygon[i, axis] - bound)
        next_distance = sign * (polygon[j, axis] - bound)
        if distance >= 0:
            for c in range(6):
                out[num_left, c] = polygon[i, c]
            num_left += 1
        if distance * next_distance < 0:
            share = distance / (distance - next_distance)
            for c in range(6):
                out[num_left, c] = polygon[i, c] + share * (polygon[j, c] - polygon[i, c])
            out[num_left, axis] = bound
            num_left += 1
    return num_left


@compiled
@no_type_check
def _slab(polygon, count, axis, index, scratch, out):
    """Clip a polygon to index <= x <= index + 1."""
    left = _cut(polygon, count, axis, float(index), 1.0, scratch)
    return _cut(scratch, left, axis, index + 1.0, -1.0, out)


@compiled
@no_type_check
def _range(polygon, count, axis):
    """Return the first and last voxel index along an axis; points in a boundary plane belong to the voxel above."""
    low, high = polygon[0, axis], polygon[0, axis]
    for i in range(1, count):
        low, high = min(low, polygon[i, axis]), max(high, polygon[i, axis])
    return int(np.floor(low)), int(np.floor(high))


@compiled
@no_type_check
def _area(polygon, count):
    """Compute a flat polygon's area, as a fan from its first corner, and its centroid's barycentric coordinates."""
    total, weighted_0, weighted_1, weighted_2 = 0.0, 0.0, 0.0, 0.0
    for i in range(1, count - 1):
        ax, bx = polygon[i, 0] - polygon[0, 0], polygon[i + 1, 0] - polygon[0, 0]
        ay, by = polygon[i, 1] - polygon[0, 1], polygon[i + 1, 1] - polygon[0, 1]
        az, bz = polygon[i, 2] - polygon[0, 2], polygon[i + 1, 2] - polygon[0, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        area = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
        total += area
        weighted_0 += area * (polygon[0, 3] + polygon[i, 3] + polygon[i + 1, 3])
        weighted_1 += area * (polygon[0, 4] + polygon[i, 4] + polygon[i + 1, 4])
        weighted_2 += area * (polygon[0, 5] + polygon[i, 5] + polygon[i + 1, 5])
    if total > 0:
        return total, weighted_0 / (3 * total), weighted_1 / (3 * total), weighted_2 / (3 * total)
    return 0.0, polygon[0, 3], polygon[0, 4], polygon[0, 5]


@compiled
@no_type_check
def _cut_one(triangle, face, resolution, start, write, keys, faces, areas, centroids):
    max_corners = 12  # a triangle cut by six planes has at most nine
    scratch, in_x = np.empty((max_corners, 6)), np.empty((max_corners, 6))
    in_xy, in_xyz = np.empty((max_corners, 6)), np.empty((max_corners, 6))
    polygon = np.zeros((3, 6))
    for i in range(3):
        polygon[i, 3 + i] = 1.0
        for c in range(3):
            polygon[i, c] = triangle[i, c]
    place = start
    first_x, last_x = _range(polygon, len(polygon), _X)
    for x in range(first_x, last_x + 1):
        count_x = _slab(polygon, len(polygon), _X, x, scratch, in_x)
        if count_x == 0:
            continue
        first_y, last_y = _range(in_x, count_x, _Y)
        for y in range(first_y, last_y + 1):
            count_y = _slab(in_x, count_x, _Y, y, scratch, in_xy)
            if count_y == 0:
                continue
            first_z, last_z = _range(in_xy, count_y, _Z)
            for z in range(first_z, last_z + 1):
                count_z = _slab(in_xy, count_y, _Z, z, scratch, in_xyz)
                if count_z == 0:
                    continue
                if write:
                    area, centroid_0, centroid_1, centroid_2 = _area(in_xyz, count_z)
                    areas[place] = area
                    keys[place] = (x * resolution + y) * resolution + z
                    faces[place] = face
                    centroids[place, 0], centroids[place, 1], centroids[place, 2] = centroid_0, centroid_1, centroid_2
                place += 1
    return place - start


@compiled
@no_type_check
def _cut_all(corners, resolution, counts, starts, write, keys, faces, areas, centroids):
    for face in range(len(corners)):
        num_pieces = _cut_one(corners[face], face, resolution, starts[face], write, keys, faces, areas, centroids)
        if not write:
            counts[face] = num_pieces
