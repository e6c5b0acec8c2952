"""Closed surfaces of Gaussians: of what stands on the ground, in the photos' colours, and of what is cut out of it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from dynamictree.errors import InputError, MeshError, ReconstructionError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud
from dynamictree.mesh import TriangleMesh, connected_parts, edges_of, vertex_normals
from dynamictree.reconstruct.cameras import ADVICE
from dynamictree.reconstruct.cut import BESIDE
from dynamictree.reconstruct.floaters import faint_floaters
from dynamictree.reconstruct.scene import Scene
from dynamictree.reconstruct.splat_table import cloud_of
from dynamictree.reconstruct.views import View
from dynamictree.render import Look, Renderer

_MAX_FACES, _LEAST_FACES = 120_000, 50
_SPECK_FACES = 24  # a piece of fewer is noise
_GAP = 0.06  # of the region's radius: pieces nearer to one another belong together
_CELLS = 416  # along the longest side: with 320 a stem was 1.4 to 1.8 times as wide as it is
_SMOOTHING = (0.5, -0.53)  # Taubin's pair of steps, which smooths and does not shrink
_SMOOTHING_ROUNDS = 4
_COLOR_SIDE_PX = 640
_LOW, _HIGH = (-1.0, -1.0, -1.0), (1.0, 1.0, 2.0)  # corners of the region that the pictures hold
_GROUND = 0.02  # of the region's radius: lower parts count as ground
_WIDEST, _FAINTEST = 0.15, 0.1  # Gaussians that count for the surface: of the region's radius, and of opacity


def mesh_of_scene(table: Float32[np.ndarray, "G P"], scene: Scene) -> TriangleMesh:
    """Surface of what stands on the ground, smoothed, in the photos' colours and the scene's frame.

    Raises:
        ReconstructionError: there is no surface.
    """
    cloud = cloud_of(table)
    low = (*_LOW[:2], _GROUND) if scene.ground_found else _LOW
    inside = ((cloud.means > low) & (cloud.means < _HIGH)).all(axis=1)
    inside &= (cloud.scales.max(axis=1) < _WIDEST) & (cloud.opacity > _FAINTEST)
    if any(view.alpha is None for view in scene.model.views):
        inside &= ~faint_floaters(cloud, inside)
    try:
        mesh = _surface(cloud.subset(inside), 1.0)
    except InputError as error:
        problem = f"{len(scene.model.views)} photos fit together, but {error}"
        raise ReconstructionError(f"{problem}; {ADVICE}") from error
    mesh = mesh.with_vertices(_smoothed(mesh))
    return replace(mesh, look=replace(mesh.look, vertex_colors=photo_colors(mesh, scene.model.views)))


def mesh_of_plant(
    scene: GaussianCloud, own: Bool[np.ndarray, " G"], whole: TriangleMesh, radius_m: float
) -> TriangleMesh:
    """Surface of the plant's Gaussians, in the colours of the whole mesh where that is near.

    Args:
        scene: all Gaussians.
        own: which of them are the plant.
        whole: mesh of the scene.
        radius_m: of the region that the photos look at.

    Raises:
        InputError: the plant has no surface.
    """
    mesh = _surface(scene.subset(own), radius_m)
    colors = mesh.look.vertex_colors
    if colors is not None and whole.look.vertex_colors is not None:
        gap, nearest = cKDTree(whole.vertices).query(mesh.vertices, distance_upper_bound=BESIDE * radius_m)
        near = np.isfinite(gap)
        colors[near] = whole.look.vertex_colors[np.asarray(nearest)[near]]
    return mesh


def _surface(cloud: GaussianCloud, radius: float) -> TriangleMesh:
    """The largest group of pieces that lie near one another, of the surface where Gaussians are opaque.

    Raises:
        InputError: it has fewer than 50 faces.
    """
    problem = f"{cloud.num_gaussians} Gaussians have no surface"
    try:
        mesh = mesh_of_cloud(cloud, cells_along=_CELLS, max_faces=_MAX_FACES)
    except (InputError, MeshError, ValueError) as error:
        raise InputError(f"{problem}: {error}; choose more of the scene") from error
    mesh = main_cluster(mesh, _GAP * radius)
    if mesh.num_faces < _LEAST_FACES:
        raise InputError(f"{problem}: it has {mesh.num_faces} faces; {_LEAST_FACES} are needed")
    return mesh


def main_cluster(mesh: TriangleMesh, gap: float) -> TriangleMesh:
    """The largest group of pieces that lie closer together than about the gap; specks count for nothing.

    Leaves and twigs seldom hang together in a mesh of photos, but they are near one another.
    """
    piece = connected_parts(mesh.faces, mesh.num_vertices)[mesh.faces[:, 0]]
    chosen = (np.bincount(piece) >= _SPECK_FACES)[piece]
    if chosen.any():
        centres = mesh.vertices[mesh.faces[chosen]].mean(axis=1)
        cells = ((centres - centres.min(axis=0)) / gap).astype(int)
        occupied = np.zeros(cells.max(axis=0) + 1, bool)
        occupied[tuple(cells.T)] = True
        group = label(occupied, structure=np.ones((3, 3, 3)))[0][tuple(cells.T)]
        chosen[chosen] = group == np.bincount(group).argmax()
    used, faces = np.unique(mesh.faces[chosen], return_inverse=True)
    return TriangleMesh(
        vertices=mesh.vertices[used], faces=faces.reshape(-1, 3).astype(np.int32), look=mesh.look.of(used, chosen)
    )


def photo_colors(mesh: TriangleMesh, views: tuple[View, ...]) -> UInt8[np.ndarray, "N 4"]:
    """Mean colour of each vertex in the photos that see it, those that look at it squarely first.

    A vertex that no photo sees takes the colour of the nearest that one does.
    """
    normals = vertex_normals(mesh.vertices.astype(np.float64), mesh.faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    total, weight = np.zeros((mesh.num_vertices, 3)), np.zeros(mesh.num_vertices)
    slack = 0.01 * mesh.height_m
    renderers: dict[tuple[int, int], Renderer] = {}
    for view in views:
        shrink = min(1.0, _COLOR_SIDE_PX / max(view.image.shape[:2]))
        width, height = round(view.image.shape[1] * shrink), round(view.image.shape[0] * shrink)
        if (width, height) not in renderers:
            renderers[width, height] = Renderer(mesh, Look(width=width, height=height, shadows=False))
        nearest = renderers[width, height].buffers(view.camera).depth_m
        x, y, depth = view.camera.project(mesh.vertices, width, height).T
        inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        column, row = np.where(inside, x, 0).astype(int), np.where(inside, y, 0).astype(int)
        toward = view.camera.position_m - mesh.vertices
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        squarely = np.clip((normals * toward).sum(axis=1), 0, 1) ** 2
        share = np.where(inside & (depth < nearest[row, column] + slack), squarely, 0)
        at = np.minimum((np.stack([y, x]) / shrink).astype(int), np.array(view.image.shape[:2])[:, None] - 1)
        at = np.where(inside, at, 0)
        total += share[:, None] * view.image[at[0], at[1]]
        weight += share
    seen = weight > 1e-3
    color = np.full((mesh.num_vertices, 4), 255, np.uint8)
    color[seen, :3] = (total[seen] / weight[seen, None]).round()
    if seen.any() and not seen.all():
        nearest_seen = cKDTree(mesh.vertices[seen]).query(mesh.vertices[~seen])[1]
        color[~seen] = color[seen][nearest_seen]
    return color


def _smoothed(mesh: TriangleMesh) -> Float32[np.ndarray, "N 3"]:
    edges = edges_of(mesh.faces)
    both = np.concatenate([edges, edges[:, ::-1]])
    number = mesh.num_vertices
    links = coo_array((np.ones(len(both), np.float32), (both[:, 0], both[:, 1])), shape=(number, number)).tocsr()
    degree = np.maximum(links.sum(axis=1), 1)[:, None]
    vertices = mesh.vertices
    for _ in range(_SMOOTHING_ROUNDS):
        for step in _SMOOTHING:
            vertices = vertices + np.float32(step) * (links @ vertices / degree - vertices)
    smooth: Float32[np.ndarray, "N 3"] = vertices.astype(np.float32)
    return smooth
