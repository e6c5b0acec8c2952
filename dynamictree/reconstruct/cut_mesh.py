"""Mesh of what is cut out of a finished reconstruction."""

import numpy as np
from jaxtyping import Bool, Float32, Int32
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dynamictree.errors import InputError, MeshError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud
from dynamictree.mesh import MeshLook, TriangleMesh, connected_parts
from dynamictree.reconstruct.coloured_mesh import MAX_FACES
from dynamictree.reconstruct.cut import BESIDE
from dynamictree.reconstruct.fusion import Surface, main_cluster
from dynamictree.reconstruct.scene import GAP
from dynamictree.request_model import Box

_LEAST_FACES = 50
_CELLS = 416  # along the longest side of a surface that is made anew, as in `coloured_mesh`
_VOTERS = 9  # visible Gaussians around a vertex, of which most decide; one alone perforates the mesh
_VISIBLE = 0.05  # opacity of Gaussians that decide what a face shows
_PATCH_SHARE = 0.01  # of the chosen faces: a smaller patch that is missing among them is a hole
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
    mesh: TriangleMesh, scene: GaussianCloud, own: Bool[np.ndarray, " G"], *, radius_m: float
) -> TriangleMesh:
    """The part of the mesh around which most Gaussians are the plant's, or the closed surface of these.

    The part is taken where it lacks little of the plant and has at most twice as many holes as the whole mesh.

    Args:
        mesh: of the whole scene.
        scene: all Gaussians.
        own: which of them are the plant.
        radius_m: of the region that the photos look at.

    Raises:
        InputError: the plant has no surface.
    """
    visible = np.flatnonzero(scene.opacity >= _VISIBLE)
    nearest = visible[cKDTree(scene.means[visible]).query(mesh.vertices, k=min(_VOTERS, len(visible)))[1]]
    majority = own[nearest].reshape(mesh.num_vertices, -1).mean(axis=1) > 0.5
    chosen = _without_patches(majority[mesh.faces].all(axis=1), mesh)
    if chosen.sum() >= _LEAST_FACES:
        faces = mesh.faces[chosen]
        part = _with_faces(mesh, faces)
        gap = cKDTree(part.vertices).query(scene.means[own], distance_upper_bound=BESIDE * radius_m)[0]
        if np.isfinite(gap).mean() >= _COVERED and num_holes(part) <= 2 * num_holes(mesh):
            return part
    return _closed_mesh(scene.subset(own), mesh, radius_m)


def _without_patches(chosen: Bool[np.ndarray, " F"], mesh: TriangleMesh) -> Bool[np.ndarray, " F"]:
    """Chosen faces, with small patches among them that floaters before the surface have taken out."""
    rest = mesh.faces[~chosen]
    part_of_vertex = connected_parts(rest, mesh.num_vertices)
    part = part_of_vertex[rest[:, 0]]
    size = np.bincount(part, minlength=mesh.num_vertices)
    beside = np.zeros(len(size), np.bool_)
    beside[part_of_vertex[mesh.faces[chosen]]] = True
    whole = chosen.copy()
    whole[~chosen] = (beside & (size < _PATCH_SHARE * chosen.sum()))[part]
    return whole


def num_holes(mesh: TriangleMesh) -> int:
    """Boundary loops: connected chains of edges that one face has alone."""
    sides = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, times = np.unique(sides, axis=0, return_counts=True)
    nodes, rows = np.unique(edges[times == 1], return_inverse=True)
    if len(nodes) == 0:
        return 0
    first, second = rows.reshape(-1, 2).T
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(len(nodes), len(nodes)))
    return int(connected_components(graph, directed=False)[0])


def _closed_mesh(plant: GaussianCloud, whole: TriangleMesh, radius_m: float) -> TriangleMesh:
    """Surface of the plant's Gaussians, in the photos' colours where the whole mesh is near."""
    try:
        mesh = mesh_of_cloud(plant, cells_along=_CELLS, max_faces=MAX_FACES)
    except (InputError, MeshError, ValueError) as error:
        raise InputError("the plant that was cut out has no surface; draw more strokes on it") from error
    surface = main_cluster(Surface(mesh.vertices, mesh.faces), GAP * radius_m)
    if mesh.look.vertex_colors is None or len(surface.faces) < _LEAST_FACES:
        return mesh
    colors = mesh.look.vertex_colors[cKDTree(mesh.vertices).query(surface.vertices)[1]]
    if whole.look.vertex_colors is not None:
        gap, nearest = cKDTree(whole.vertices).query(surface.vertices, distance_upper_bound=BESIDE * radius_m)
        near = np.isfinite(gap)
        colors[near] = whole.look.vertex_colors[np.asarray(nearest)[near]]
    return TriangleMesh(vertices=surface.vertices, faces=surface.faces, look=MeshLook(vertex_colors=colors))


def _with_faces(mesh: TriangleMesh, faces: Int32[np.ndarray, "F 3"]) -> TriangleMesh:
    used, rows = np.unique(faces, return_inverse=True)
    colors = None if mesh.look.vertex_colors is None else mesh.look.vertex_colors[used]
    return TriangleMesh(
        vertices=mesh.vertices[used], faces=rows.reshape(-1, 3).astype(np.int32), look=MeshLook(vertex_colors=colors)
    )
