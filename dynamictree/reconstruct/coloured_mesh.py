"""Coloured mesh of the subject above the ground, from depth maps or from the splat."""

from collections.abc import Sequence
from dataclasses import replace

import fast_simplification
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from dynamictree.errors import InputError, MeshError, ReconstructionError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud
from dynamictree.mesh import MeshLook, Surface, TriangleMesh, edges_of, vertex_normals
from dynamictree.reconstruct.cameras import ADVICE
from dynamictree.reconstruct.fusion import EMPTY_SURFACE, Box, faces_above, fuse, main_cluster
from dynamictree.reconstruct.scene import CLUSTER_GAP, LEAST_FACES, Scene
from dynamictree.reconstruct.splat_table import cloud_of
from dynamictree.reconstruct.surface_choice import NEAR_SHARE, best_mesh
from dynamictree.reconstruct.views import View
from dynamictree.render import Renderer, RenderSettings

MAX_FACES = 48_000
CELLS = 416  # cells along the longest side; with 320 a stem became 1.4 to 1.8 times too wide
_REGION = Box(low=np.array([-1.0, -1.0, -1.0]), high=np.array([1.0, 1.0, 2.0]))  # region that the photos show


def stereo_surface(scene: Scene) -> Surface:
    """Fuse the depth maps into the subject's surface; empty if they show none."""
    voxels = 128  # number along the longest side
    if scene.subject is None:
        return EMPTY_SURFACE
    fused = fuse(scene.depths.views, scene.depths.depths, scene.subject, resolution=voxels)
    return main_cluster(faces_above(fused, scene.cut), CLUSTER_GAP)


def splat_surface(table: Float32[np.ndarray, "G P"], scene: Scene) -> Surface:
    """Extract the subject's surface from its Gaussians: opacity on a grid, then marching cubes.

    If the ground was found, the whole region above it is searched: the box of stereo may lack part of the crown.

    Raises:
        ReconstructionError: no Gaussian is opaque enough.
    """
    widest, faintest = 0.15, 0.1  # share of the region's radius, and opacity: limits of Gaussians that form the surface
    cloud = cloud_of(table)
    box = _REGION if scene.ground_found or scene.subject is None else scene.subject
    low = np.maximum(box.low, [-np.inf, -np.inf, scene.cut])
    inside = ((cloud.means > low) & (cloud.means < box.high)).all(axis=1)
    inside &= (cloud.scales.max(axis=1) < widest) & (cloud.opacity > faintest)
    try:
        mesh = mesh_of_cloud(cloud.subset(inside), cells_along=CELLS, max_faces=2 * MAX_FACES, one_skin=True)
    except (InputError, ValueError) as error:
        problem = f"{len(scene.model.views)} photos fit together, but {int(inside.sum())} Gaussians make no surface"
        raise ReconstructionError(f"{problem}; {ADVICE}") from error
    return main_cluster(mesh, CLUSTER_GAP)


def best_mesh_of(table: Float32[np.ndarray, "G P"], scene: Scene, apart: Sequence[str]) -> tuple[TriangleMesh, str]:
    """Choose the mesh of stereo or of the splat by the photos named in `apart`; return the mesh and its name.

    Raises:
        ReconstructionError: there is no surface.
    """
    meshes = {}
    stereo = stereo_surface(scene)
    if len(stereo.faces) >= LEAST_FACES:
        meshes["stereo"] = finished_mesh(stereo, scene)
    try:
        meshes["splat"] = finished_mesh(splat_surface(table, scene), scene)
    except ReconstructionError:
        if not meshes:
            raise
    views = [view for view in scene.matched.views if view.source in apart]
    name = best_mesh(meshes, cloud_of(table), views, radius=1.0)
    return meshes[name], name


def finished_mesh(surface: Surface, scene: Scene) -> TriangleMesh:
    """Decimate, smooth and colour a surface in the scene's frame.

    Raises:
        ReconstructionError: there is no surface.
    """
    if len(surface.faces) < LEAST_FACES:
        number, agreed = len(scene.model.views), len(surface.faces)
        problem = f"{number} photos fit together, but they agree on {agreed} triangles of surface"
        raise ReconstructionError(f"{problem}; at least {LEAST_FACES} are needed; {ADVICE}")
    surface = _smooth(_decimate(surface))
    mesh = TriangleMesh(vertices=surface.vertices, faces=surface.faces)
    return replace(mesh, look=replace(mesh.look, vertex_colors=photo_colors(mesh, scene.model.views)))


def photo_colors(mesh: TriangleMesh, views: tuple[View, ...]) -> UInt8[np.ndarray, "N 4"]:
    """Average each vertex's colour over the photos that see it, weighted by how squarely they look at it.

    A vertex that no photo sees takes the colour of the nearest one that is seen.
    """
    color_side_px = 640
    normals = vertex_normals(mesh.vertices.astype(np.float64), mesh.faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    total, weight = np.zeros((mesh.num_vertices, 3)), np.zeros(mesh.num_vertices)
    slack = 0.01 * mesh.height_m
    renderers: dict[tuple[int, int], Renderer] = {}
    for view in views:
        shrink = min(1.0, color_side_px / max(view.image.shape[:2]))
        width, height = round(view.image.shape[1] * shrink), round(view.image.shape[0] * shrink)
        if (width, height) not in renderers:
            renderers[width, height] = Renderer(mesh, RenderSettings(width=width, height=height, shadows=False))
        nearest = renderers[width, height].buffers(view.camera).depth_m
        at, inside = view.pixels_of(mesh.vertices)
        row, column = at[0] * height // len(view.image), at[1] * width // view.image.shape[1]
        away = mesh.vertices - view.camera.position_m
        squarely = np.clip(-(normals * away).sum(axis=1) / np.linalg.norm(away, axis=1), 0, 1) ** 2
        depth = away @ view.camera.world_to_camera[2]
        share = np.where(inside & (depth < nearest[row, column] + slack), squarely, 0)
        total += share[:, None] * view.image[at]
        weight += share
    seen = weight > 1e-3
    color = np.full((mesh.num_vertices, 4), 255, np.uint8)
    color[seen, :3] = (total[seen] / weight[seen, None]).round()
    if seen.any() and not seen.all():
        nearest_seen = cKDTree(mesh.vertices[seen]).query(mesh.vertices[~seen])[1]
        color[~seen] = color[seen][nearest_seen]
    return color


def _decimate(surface: Surface) -> Surface:
    if len(surface.faces) <= MAX_FACES:
        return surface
    vertices, faces = fast_simplification.simplify(surface.vertices, surface.faces, target_count=MAX_FACES)
    return Surface(vertices=vertices.astype(np.float32), faces=faces.astype(np.int32))


def _smooth(surface: Surface) -> Surface:
    smoothing_rounds = 4
    smoothing = (0.5, -0.53)  # Taubin's pair of steps: smooths without shrinking
    edges = edges_of(surface.faces)
    both = np.concatenate([edges, edges[:, ::-1]])
    number = len(surface.vertices)
    links = coo_array((np.ones(len(both), np.float32), (both[:, 0], both[:, 1])), shape=(number, number)).tocsr()
    degree = np.maximum(links.sum(axis=1), 1)[:, None]
    vertices: Float32[np.ndarray, "N 3"] = surface.vertices
    for _ in range(smoothing_rounds):
        for step in smoothing:
            vertices = vertices + np.float32(step) * (links @ vertices / degree - vertices)
    return Surface(vertices=vertices.astype(np.float32), faces=surface.faces)


def mesh_of_plant(
    scene: GaussianCloud, own: Bool[np.ndarray, " G"], whole: TriangleMesh, radius_m: float
) -> TriangleMesh:
    """Extract a closed surface from the plant's Gaussians, with the colours of the whole mesh where that is near.

    Args:
        scene: all Gaussians.
        own: mask of the plant's Gaussians.
        whole: mesh of the scene.
        radius_m: radius of the region that the photos show.

    Raises:
        InputError: the plant has no surface.
    """
    try:
        mesh = mesh_of_cloud(scene.subset(own), cells_along=CELLS, max_faces=MAX_FACES, one_skin=True)
    except (InputError, MeshError, ValueError) as error:
        raise InputError(f"{int(own.sum())} Gaussians have no surface: {error}; choose more of the scene") from error
    surface = main_cluster(mesh, CLUSTER_GAP * radius_m)
    if len(surface.faces) < 50:
        raise InputError(f"the surface has {len(surface.faces)} faces; 50 are needed; choose more of the scene")
    assert mesh.look.vertex_colors is not None
    colors = mesh.look.vertex_colors[cKDTree(mesh.vertices).query(surface.vertices)[1]]
    if whole.look.vertex_colors is not None:
        gap, nearest = cKDTree(whole.vertices).query(surface.vertices, distance_upper_bound=NEAR_SHARE * radius_m)
        near = np.isfinite(gap)
        colors[near] = whole.look.vertex_colors[np.asarray(nearest)[near]]
    return TriangleMesh(vertices=surface.vertices, faces=surface.faces, look=MeshLook(vertex_colors=colors))
