"""Mesh of what is cut out of a finished reconstruction."""

import numpy as np
from jaxtyping import Bool
from scipy.spatial import cKDTree

from dynamictree.errors import InputError, MeshError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud
from dynamictree.mesh import MeshLook, TriangleMesh
from dynamictree.reconstruct.coloured_mesh import CELLS, MAX_FACES
from dynamictree.reconstruct.cut import BESIDE
from dynamictree.reconstruct.fusion import Surface, main_cluster
from dynamictree.reconstruct.scene import GAP

_LEAST_FACES = 50


def mesh_of_plant(
    scene: GaussianCloud, own: Bool[np.ndarray, " G"], whole: TriangleMesh, radius_m: float
) -> TriangleMesh:
    """Closed surface of the plant's Gaussians, in the colours of the whole mesh where that is near.

    Args:
        scene: all Gaussians.
        own: which of them are the plant.
        whole: mesh of the scene.
        radius_m: of the region that the photos look at.

    Raises:
        InputError: the plant has no surface.
    """
    try:
        mesh = mesh_of_cloud(scene.subset(own), cells_along=CELLS, max_faces=MAX_FACES)
    except (InputError, MeshError, ValueError) as error:
        raise InputError(f"{int(own.sum())} Gaussians have no surface: {error}; choose more of the scene") from error
    surface = main_cluster(Surface(mesh.vertices, mesh.faces), GAP * radius_m)
    if len(surface.faces) < _LEAST_FACES:
        problem = f"the surface has {len(surface.faces)} faces; {_LEAST_FACES} are needed"
        raise InputError(f"{problem}; choose more of the scene")
    assert mesh.look.vertex_colors is not None
    colors = mesh.look.vertex_colors[cKDTree(mesh.vertices).query(surface.vertices)[1]]
    if whole.look.vertex_colors is not None:
        gap, nearest = cKDTree(whole.vertices).query(surface.vertices, distance_upper_bound=BESIDE * radius_m)
        near = np.isfinite(gap)
        colors[near] = whole.look.vertex_colors[np.asarray(nearest)[near]]
    return TriangleMesh(vertices=surface.vertices, faces=surface.faces, look=MeshLook(vertex_colors=colors))
