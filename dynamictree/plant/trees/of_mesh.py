"""Segment the trees of a mesh: points on its surface are segmented, and each connected part belongs to one tree."""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64

from dynamictree.errors import InputError
from dynamictree.mesh import Surface, TriangleMesh, connected_parts, weld
from dynamictree.plant.sample import face_areas, on_faces
from dynamictree.plant.trees.cells import CELLS_TALL
from dynamictree.plant.trees.segment import require_tree, segment_trees, several_trees
from dynamictree.up_axis import up_rotation

MAX_POINTS = 500_000
MAX_RESOLUTION = 512


def with_trees(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh with its trees segmented, if there are several."""
    moving = mesh.moving_part
    points, face = dense_points(moving)
    if len(points) == 0 or np.ptp(points[:, 2]) <= 0:
        return mesh
    tree = segment_trees(points)
    count = int(tree.max()) + 1
    if count == 1:
        return mesh
    trees = _of_faces(moving, face, tree, count)
    face_tree = np.full(mesh.num_faces, -1, np.int32)
    face_tree[np.ones(mesh.num_faces, np.bool_) if mesh.still_faces is None else ~mesh.still_faces] = trees
    return replace(mesh, face_tree=face_tree, warnings=(*mesh.warnings, several_trees(count)))


def dense_points(mesh: Surface) -> tuple[Float64[np.ndarray, "P 3"], Int64[np.ndarray, " P"]]:
    """Sample points on the surface, as dense as the cells of the segmentation; return them with their faces."""
    density = 1.5  # points per cell of surface
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    size = float(np.ptp(corners[:, :, 2])) / CELLS_TALL
    if size <= 0:
        return np.zeros((0, 3)), np.zeros(0, np.int64)
    count = np.ceil(density * np.maximum(face_areas(mesh) / size**2, longest / size)) + 1
    return on_faces(mesh, np.ceil(count * min(1.0, MAX_POINTS / count.sum())).astype(np.int64))


def mesh_points(mesh: Surface) -> tuple[Float32[np.ndarray, "P 3"], Int32[np.ndarray, " P"] | None]:
    """Return the corners of the plant's faces, with the tree of each if there are several."""
    moving = mesh.moving_part
    trees = None if moving.face_tree is None else np.repeat(moving.face_tree, 3)
    return mesh.vertices[moving.faces.ravel()], trees


def feet_are_level(mesh: Surface, up_axis: str) -> bool:
    """Whether three or more trees would stand on one ground if `up_axis` were up; True for fewer trees."""
    points, tree = mesh_points(mesh)
    if tree is None or tree.max() < 2:
        return True
    height = points @ up_rotation(up_axis)[2]
    ends = np.array([[height[tree == one].min(), height[tree == one].max()] for one in np.unique(tree)])
    return bool(np.ptp(ends[:, 0]) <= np.diff(ends).max())


def only_tree_of(mesh: TriangleMesh, number: int) -> TriangleMesh:
    """Extract one of several trees, counted from 1, without still parts.

    Raises:
        InputError: there is no such tree, or all of it stands still.
    """
    require_tree(number, mesh.face_tree)
    if mesh.face_tree is None:
        return mesh
    own = mesh.face_tree == number - 1
    if mesh.still_faces is not None and mesh.still_faces[own].all():
        raise InputError(f"still, still_box_m and box_m leave nothing of tree {number} that moves")
    vertices, corner = np.unique(mesh.faces[own], return_inverse=True)
    return replace(
        mesh,
        vertices=mesh.vertices[vertices],
        faces=corner.reshape(-1, 3).astype(np.int32),
        still_faces=None if mesh.still_faces is None or not mesh.still_faces[own].any() else mesh.still_faces[own],
        face_tree=None,
        look=mesh.look.of(vertices, own),
        parts=replace(mesh.parts, of_face=None if mesh.parts.of_face is None else mesh.parts.of_face[own]),
        gltf=None,
    )


def stand_resolution(mesh: Surface, resolution: int) -> int:
    """Return a grid resolution for several trees, which gives the largest about the resolution of a single one."""
    points, tree = mesh_points(mesh)
    if tree is None:
        return resolution
    largest = max(float(np.ptp(points[tree == number], axis=0).max()) for number in np.unique(tree))
    doublings = max(0, round(math.log2(float(np.ptp(points, axis=0).max()) / largest)))
    return max(resolution, min(resolution << doublings, MAX_RESOLUTION))


def _of_faces(
    mesh: Surface, face: Int64[np.ndarray, " P"], tree: Int32[np.ndarray, " P"], count: int
) -> Int32[np.ndarray, " F"]:
    """Return the tree of each face: that of its connected part, or of its own points if the part spans trees."""
    one_tree = 0.9  # share of a connected part's points in one tree, from which all of it is
    welded, _ = weld(mesh)
    part = connected_parts(welded.faces, welded.num_vertices)[welded.faces[:, 0]]
    votes = np.zeros((int(part.max()) + 1, count))
    standing = tree >= 0
    np.add.at(votes, (part[face[standing]], tree[standing]), 1)
    own = np.zeros((mesh.num_faces, count))
    np.add.at(own, (face[standing], tree[standing]), 1)
    whole = votes.max(axis=1) >= one_tree * votes.sum(axis=1)
    small = np.bincount(part, minlength=len(votes)) < 0.01 * mesh.num_faces
    shared = ~(whole | small)[part] & (own.sum(axis=1) > 0)
    return np.asarray(np.where(shared, own.argmax(axis=1), votes.argmax(axis=1)[part]), np.int32)
