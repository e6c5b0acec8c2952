"""Normals of a mesh for shading: the source's, else smooth ones; and their rotation while the mesh moves."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.mesh import TriangleMesh, unit_vectors, vertex_normals

_SMOOTH = 0.5
"""Cosine of the angle up to which vertices at one place share a normal: 60°."""


def rest_normals(mesh: TriangleMesh) -> Float32[np.ndarray, "N 3"]:
    """Return a unit normal per vertex: the source's, else the mean of the faces around its place, else +Z."""
    normals = _smooth_normals(mesh)
    if mesh.look.normals is not None:
        stated = (mesh.look.normals != 0).any(axis=1, keepdims=True)
        normals = np.where(stated, mesh.look.normals, normals)
    normals[~(normals != 0).any(axis=1)] = (0, 0, 1)
    return normals


def iter_normals(
    mesh: TriangleMesh, frames: Iterable[Float32[np.ndarray, "N 3"]]
) -> Iterator[Float32[np.ndarray, "N 3"]]:
    """Yield the normals of each frame: those at rest, turned with the faces around each vertex.

    `frames` are displacements [m].
    """
    rest, before = rest_normals(mesh), unit_vectors(_face_normals(mesh, None))
    for displacement in frames:
        yield _turned(rest, before, unit_vectors(_face_normals(mesh, displacement)))


def turn_normals(
    normals: Float32[np.ndarray, "N 3"], matrices: Float64[np.ndarray, "*n 3 3"]
) -> Float32[np.ndarray, "N 3"]:
    """Transform normals by the inverse transpose of the matrices of the points, one for all or one per vertex."""
    x, y, z = (matrices[..., i, :] for i in range(3))
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=-2)  # det · inverse transpose
    sign = np.where((x * cofactors[..., 0, :]).sum(axis=-1) < 0, -1.0, 1.0)  # sign of the determinant
    return unit_vectors(
        np.einsum("...,...ij,nj->ni" if matrices.ndim == 2 else "n,nij,nj->ni", sign, cofactors, normals)
    )


def _face_normals(mesh: TriangleMesh, displacement: Float32[np.ndarray, "N 3"] | None) -> Float64[np.ndarray, "N 3"]:
    vertices = mesh.vertices if displacement is None else mesh.vertices + displacement
    return vertex_normals(vertices.astype(np.float64), mesh.faces)


def _smooth_normals(mesh: TriangleMesh) -> Float32[np.ndarray, "N 3"]:
    """Average normals over vertices at one place, which files split at texture seams, unless there is a sharp edge."""
    neighbours = 32  # vertices at one place that are compared; more are leaves that cross there
    own = _face_normals(mesh, None)
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    order = np.argsort(place.ravel(), kind="stable")
    place, own = place.ravel()[order], own[order]
    unit, total = unit_vectors(own), own.copy()
    for offset in range(1, min(int(np.bincount(place).max()), neighbours)):
        near = (place[offset:] == place[:-offset]) & ((unit[offset:] * unit[:-offset]).sum(axis=1) > _SMOOTH)
        total[:-offset][near] += own[offset:][near]
        total[offset:][near] += own[:-offset][near]
    normals = np.empty_like(unit)
    normals[order] = unit_vectors(total)
    return normals


def _turned(
    normals: Float32[np.ndarray, "N 3"], before: Float32[np.ndarray, "N 3"], after: Float32[np.ndarray, "N 3"]
) -> Float32[np.ndarray, "N 3"]:
    """Turn normals by the smallest rotation from `before` to `after`; where one of these is 0, leave them."""
    axis = np.cross(before, after)
    cosine = (before * after).sum(axis=1, keepdims=True)
    once = np.cross(axis, normals)
    turned = normals + once + np.cross(axis, once) / np.maximum(1 + cosine, 1e-3)
    sound = (before != 0).any(axis=1, keepdims=True) & (after != 0).any(axis=1, keepdims=True)
    return unit_vectors(np.where(sound, turned, normals).astype(np.float64))
