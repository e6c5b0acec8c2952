"""Sample points on the surface of a mesh, so that rules for clouds apply to meshes."""

import numpy as np
from jaxtyping import Float64, Int64

from dynamictree.mesh import Surface
from dynamictree.planes import Points


def surface_points(mesh: Surface, num_points: int) -> tuple[Points, Int64[np.ndarray, " P"]] | None:
    """Sample points evenly and deterministically; return them with their faces, or None without surface."""
    area = face_areas(mesh)
    total = float(area.sum())
    if not total > 0:
        return None
    ends = np.floor(np.cumsum(area) / total * num_points + 0.5).astype(np.int64)
    return on_faces(mesh, np.diff(ends, prepend=0))


def on_faces(mesh: Surface, counts: Int64[np.ndarray, " F"]) -> tuple[Points, Int64[np.ndarray, " P"]]:
    """Sample a number of points on each face; return them with their faces."""
    steps = 0.7548776662466927, 0.5698402909980532  # plastic number's R2 sequence: fills a square evenly (Roberts 2018)
    face = np.repeat(np.arange(mesh.num_faces), counts)
    u, v = (along - np.floor(along) for along in (np.arange(len(face)) * step for step in steps))
    root = np.sqrt(u)
    weights = 1 - root, root * (1 - v), root * v
    corners = mesh.vertices.T.astype(np.float64)[:, mesh.faces.T]  # [3, 3, F], axis and corner
    points = [sum(w * np.repeat(p, counts) for w, p in zip(weights, places, strict=True)) for places in corners]
    return np.stack(points, axis=1), face


def face_normals(mesh: Surface) -> Float64[np.ndarray, "F 3"]:
    """Compute the normals of the faces, with lengths of twice the areas."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(b - a, c - a)


def face_areas(mesh: Surface) -> Float64[np.ndarray, " F"]:
    """Compute the area of each face [m²]."""
    return np.asarray(np.linalg.norm(face_normals(mesh), axis=1) / 2)
