"""Exact nearest face of each point within a distance, by a grid of cells that list their faces."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64

from dynamictree.parallel import compiled, in_bands


@dataclass(frozen=True, kw_only=True)
class NearestFaces:
    """Nearest face of each point, and the nearest position on it."""

    faces: Int32[np.ndarray, " G"]  # -1 if no face is within reach
    weights: Float32[np.ndarray, "G 3"]  # barycentric weights of the nearest point on the face


def nearest_faces(
    points: Float32[np.ndarray, "G 3"],
    vertices: Float32[np.ndarray, "N 3"],
    faces: Int32[np.ndarray, "F 3"],
    reach: float | Float64[np.ndarray, " G"],
) -> NearestFaces:
    """Find each point's nearest face, from its cell outward, shell by shell, up to its reach."""
    none = -1
    cells_along = 128  # cells along the largest extent; 1 million points against 100,000 faces take seconds
    corners = vertices[faces].astype(np.float64)  # [F, 3, 3]
    low = corners.min(axis=(0, 1))
    extent = corners.max(axis=(0, 1)) - low
    edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    cell = max(float(extent.max()) / cells_along, float(np.median(edge)) / 2)
    shape = np.floor(extent / cell).astype(np.int64) + 1
    starts, listed = _list_faces(corners, low, cell, shape)
    nearest = np.full(len(points), none, np.int32)
    weights = np.zeros((len(points), 3), np.float32)
    places = points.astype(np.float64)
    limits = np.ascontiguousarray(np.broadcast_to(np.float64(reach), len(points)))
    in_bands(_search, len(points), places, corners, low, cell, shape, starts, listed, limits, nearest, weights)
    return NearestFaces(faces=nearest, weights=weights)


def _list_faces(
    corners: Float64[np.ndarray, "F 3 3"], low: Float64[np.ndarray, "3"], cell: float, shape: Int64[np.ndarray, "3"]
) -> tuple[Int64[np.ndarray, " cells_and_one"], Int32[np.ndarray, " listed"]]:
    """List the faces of each cell: listed[starts[c]:starts[c + 1]] for cell c."""
    counts = np.zeros(int(shape.prod()) + 1, np.int64)
    _visit(corners, low, cell, shape, counts, np.empty(0, np.int32), False)
    starts = np.concatenate([[0], np.cumsum(counts[:-1])])
    listed = np.empty(int(starts[-1]), np.int32)
    _visit(corners, low, cell, shape, starts[:-1].copy(), listed, True)
    return starts, listed


@compiled
@no_type_check
def _visit(corners, low, cell, shape, place, listed, write):
    """Count, or list, each face in the cells of its bounding box that its plane crosses."""
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in range(len(corners)):
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        for d in range(3):
            first[d] = int((min(a[d], b[d], c[d]) - low[d]) / cell)
            last[d] = min(int((max(a[d], b[d], c[d]) - low[d]) / cell), shape[d] - 1)
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        reach = 0.5 * cell * (abs(nx) + abs(ny) + abs(nz)) + 1e-9 * cell * length
        for x in range(first[0], last[0] + 1):
            for y in range(first[1], last[1] + 1):
                for z in range(first[2], last[2] + 1):
                    px = low[0] + (x + 0.5) * cell - a[0]
                    py = low[1] + (y + 0.5) * cell - a[1]
                    pz = low[2] + (z + 0.5) * cell - a[2]
                    if abs(px * nx + py * ny + pz * nz) <= reach:
                        index = (x * shape[1] + y) * shape[2] + z
                        if write:
                            listed[place[index]] = f
                        place[index] += 1


@compiled
@no_type_check
def _closest(p, a, b, c, weights):
    """Compute the squared distance from a point to a triangle; write the barycentric weights. Ericson 2005, 5.1.5."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    d1, d2 = abx * apx + aby * apy + abz * apz, acx * apx + acy * apy + acz * apz
    ab2, ac2, dot = (
        abx * abx + aby * aby + abz * abz,
        acx * acx + acy * acy + acz * acz,
        abx * acx + aby * acy + abz * acz,
    )
    d3, d4 = d1 - ab2, d2 - dot
    d5, d6 = d1 - dot, d2 - ac2
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        v, w = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v, w = d1 / (d1 - d3), 0.0
    elif d6 >= 0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    weights[0], weights[1], weights[2] = 1.0 - v - w, v, w
    x, y, z = apx - v * abx - w * acx, apy - v * aby - w * acy, apz - v * abz - w * acz
    return x * x + y * y + z * z


@compiled
@no_type_check
def _clearance(p, home, low, cell):
    """Compute the distance from a point to the nearest wall of its cell; negative outside the grid."""
    nearest = cell
    for d in range(3):
        within = p[d] - low[d] - home[d] * cell
        nearest = min(nearest, within, cell - within)
    return nearest


@compiled
@no_type_check
def _to_cell(p, x, y, z, low, cell):
    """Compute the squared distance from a point to a cell; 0 inside."""
    dx = max(low[0] + x * cell - p[0], p[0] - low[0] - (x + 1) * cell, 0.0)
    dy = max(low[1] + y * cell - p[1], p[1] - low[1] - (y + 1) * cell, 0.0)
    dz = max(low[2] + z * cell - p[2], p[2] - low[2] - (z + 1) * cell, 0.0)
    return dx * dx + dy * dy + dz * dz


@compiled
@no_type_check
def _search(first, end, points, corners, low, cell, shape, starts, listed, reach, nearest, weights):
    home, trial = np.empty(3, np.int64), np.empty(3)
    for g in range(first, end):
        p = points[g]
        best = reach[g] * reach[g]
        shell, outside = 0, 0.0
        for d in range(3):
            place = (p[d] - low[d]) / cell
            home[d] = min(max(int(np.floor(place)), 0), shape[d] - 1)
            beyond = max(-place, place - shape[d], 0.0) * cell
            outside += beyond * beyond
        if outside > best:
            continue
        inner = _clearance(p, home, low, cell)
        while shell <= max(shape[0], shape[1], shape[2]):
            within = inner + (shell - 1) * cell  # all nearer faces have been visited
            if shell > 0 and within > 0 and within * within > best:
                break
            for x in range(max(home[0] - shell, 0), min(home[0] + shell, shape[0] - 1) + 1):
                for y in range(max(home[1] - shell, 0), min(home[1] + shell, shape[1] - 1) + 1):
                    on_side = abs(x - home[0]) == shell or abs(y - home[1]) == shell
                    step = 1 if on_side or shell == 0 else 2 * shell
                    for z in range(home[2] - shell, home[2] + shell + 1, step):
                        if z < 0 or z >= shape[2]:
                            continue
                        index = (x * shape[1] + y) * shape[2] + z
                        if starts[index] == starts[index + 1] or _to_cell(p, x, y, z, low, cell) > best:
                            continue
                        for i in range(starts[index], starts[index + 1]):
                            f = listed[i]
                            distance = _closest(p, corners[f, 0], corners[f, 1], corners[f, 2], trial)
                            if distance < best or (distance == best and nearest[g] == -1):
                                best = distance
                                nearest[g] = f
                                weights[g, 0], weights[g, 1], weights[g, 2] = trial[0], trial[1], trial[2]
            shell += 1
