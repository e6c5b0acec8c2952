"""Mesh of what is cut out of a finished reconstruction."""

import numpy as np
from jaxtyping import Bool, Float32, Int32
from scipy.spatial import cKDTree

from dynamictree.errors import InputError, MeshError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud
from dynamictree.mesh import TriangleMesh
from dynamictree.request_model import Box

_LEAST_FACES = 50
_CELLS = 320  # along the longest side of a surface that is made anew
_VISIBLE = 0.05  # opacity of Gaussians that decide what a face shows
_COVERED = 0.8  # of the plant's Gaussians must have the mesh beside them


def mesh_in_box(
    box_m: Box, mesh: TriangleMesh, cloud: GaussianCloud
) -> tuple[TriangleMesh, Float32[np.ndarray, "M 3"]]:
    """The part of the mesh in the box, or the surface of the Gaussians there; and places that the plant is near to."""
    low, high = np.array(box_m)
    inside: Bool[np.ndarray, " N"] = np.all((mesh.vertices >= low) & (mesh.vertices <= high), axis=1)
    faces = mesh.faces[inside[mesh.faces].all(axis=1)]
    if len(faces) < _LEAST_FACES:
        try:
            return mesh_of_cloud(cloud, cells_along=_CELLS), cloud.means
        except (InputError, MeshError, ValueError) as error:
            raise InputError(f"nothing in the box from {box_m[0]} to {box_m[1]} has a surface; enlarge it") from error
    cropped = _with_faces(mesh, faces)
    return cropped, cropped.vertices


def plant_mesh(
    mesh: TriangleMesh, scene: GaussianCloud, own: Bool[np.ndarray, " G"], *, beside_m: float
) -> TriangleMesh:
    """The part of the mesh that lies on chosen Gaussians, or their surface where the mesh lacks much of them."""
    visible = np.flatnonzero(scene.opacity >= _VISIBLE)
    nearest = visible[cKDTree(scene.means[visible]).query(mesh.vertices)[1]]
    faces = mesh.faces[own[nearest][mesh.faces].all(axis=1)]
    if len(faces) >= _LEAST_FACES:
        part = _with_faces(mesh, faces)
        gap = cKDTree(part.vertices).query(scene.means[own], distance_upper_bound=beside_m)[0]
        if np.isfinite(gap).mean() >= _COVERED:
            return part
    try:
        return mesh_of_cloud(scene.subset(own), cells_along=_CELLS)
    except (InputError, MeshError, ValueError) as error:
        raise InputError("the plant that was cut out has no surface; draw more strokes on it") from error


def _with_faces(mesh: TriangleMesh, faces: Int32[np.ndarray, "F 3"]) -> TriangleMesh:
    used, rows = np.unique(faces, return_inverse=True)
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[used]
    return TriangleMesh(vertices=mesh.vertices[used], faces=rows.reshape(-1, 3).astype(np.int32), vertex_colors=colors)
