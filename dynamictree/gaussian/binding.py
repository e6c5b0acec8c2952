"""Bind Gaussians to mesh faces. After GaMeS (Waczyńska et al. 2024), but captured Gaussians keep their shapes.

A Gaussian is bound to its nearest surface point: barycentric weights in a face, and an offset that rotates with the
face. Gaussians far from every face, or outside the moving part, are not bound and stay still.
"""

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import Surface

STILL = -1


@dataclass(frozen=True, kw_only=True)
class Leaves:
    """Leaves of a cloud (`leaves.py`): each rotates about a vertex of the mesh."""

    of: Int32[np.ndarray, " G"]  # number of each Gaussian's leaf, or STILL
    vertex: Int32[np.ndarray, " M"]


@dataclass(frozen=True, kw_only=True)
class Binding:
    """Cloud at rest, bound to triangles. Corners 0 and 1 are the longest edge of each triangle."""

    cloud: GaussianCloud
    vertices: Float32[np.ndarray, "N 3"]  # vertices of the mesh at rest [m]
    triangles: Int32[np.ndarray, "U 3"]  # faces with bound Gaussians
    face_of: Int32[np.ndarray, " G"]  # row of `triangles`, or STILL
    weights: Float32[np.ndarray, "G 3"]  # barycentric weights
    leaves: Leaves | None = None  # None where no Gaussian flutters

    def __post_init__(self) -> None:
        if len(self.face_of) != self.cloud.num_gaussians or len(self.weights) != self.cloud.num_gaussians:
            raise InputError(f"the binding has {len(self.face_of)} rows for {self.cloud.num_gaussians} Gaussians")
        if self.face_of.min() < STILL or self.face_of.max() >= len(self.triangles):
            raise InputError(f"the binding names face {self.face_of.max()} of {len(self.triangles)}")
        if len(self.triangles) and not 0 <= self.triangles.min() <= self.triangles.max() < len(self.vertices):
            raise InputError(f"the binding's faces name vertices outside of the {len(self.vertices)} of the mesh")

    @property
    def moving(self) -> Bool[np.ndarray, " G"]:
        """Mask of the Gaussians that are bound to a face."""
        result: Bool[np.ndarray, " G"] = self.face_of != STILL
        return result


def bind(cloud: GaussianCloud, mesh: Surface, *, mask: Bool[np.ndarray, " G"] | None = None) -> Binding:
    """Bind each Gaussian of a capture to its nearest face.

    Args:
        cloud: Gaussians, whose order is retained.
        mesh: mesh at rest, in the cloud's frame [m].
        mask: Gaussians that may move; all by default.

    Raises:
        InputError: no Gaussian is left to move, or no face of the mesh has an area.
    """
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    rows = np.arange(cloud.num_gaussians) if mask is None else np.flatnonzero(mask)
    reach = _own_reach(cloud.scales[rows], extent)
    triangles = longest_edge_first(mesh.vertices, solid_faces(mesh))
    distance, nearest, nearest_weights = nearest_on_faces(cloud.means[rows], mesh.vertices, triangles)
    nearest[distance > reach] = STILL
    if (nearest == STILL).all():
        raise InputError(
            f"no Gaussian is within {reach.max(initial=0):.3g} m of the mesh and in the part that moves; "
            "are cloud and mesh in the same axes and units?"
        )
    face_of = np.full(cloud.num_gaussians, STILL, np.int32)
    weights = np.zeros((cloud.num_gaussians, 3), np.float32)
    face_of[rows], weights[rows] = nearest, nearest_weights
    return _compact(cloud, mesh.vertices, triangles, face_of, weights)


def nearest_on_faces(
    points: Float32[np.ndarray, "G 3"], vertices: Float32[np.ndarray, "N 3"], triangles: Int32[np.ndarray, "F 3"]
) -> tuple[Float64[np.ndarray, " G"], Int32[np.ndarray, " G"], Float32[np.ndarray, "G 3"]]:
    """Return each point's distance to the surface [m], its nearest triangle and the barycentric weights there."""
    points_at_once = 500_000  # 100 MB
    distance, face_of = np.empty(len(points)), np.empty(len(points), np.int32)
    weights = np.empty((len(points), 3), np.float32)
    places, corners, tree = vertices.astype(np.float64), triangles.astype(np.int64), igl.AABB()
    tree.init(places, corners)
    for start in range(0, len(points), points_at_once):
        some = slice(start, start + points_at_once)
        squared, face_of[some], place = tree.squared_distance(places, corners, points[some].astype(np.float64))
        own = igl.barycentric_coordinates(place, *(places[corner] for corner in corners[face_of[some]].T)).clip(0, 1)
        distance[some] = np.sqrt(squared)
        weights[some] = own / own.sum(axis=1, keepdims=True)
    return distance, face_of, weights


def _own_reach(scales: Float32[np.ndarray, "G 3"], extent: float) -> Float64[np.ndarray, " G"]:
    """Return each Gaussian's largest binding distance [m]; it grows with the size of the Gaussian."""
    inside_share = 0.5  # share of the mesh's extent; Gaussians in a tree are nearer to its surface, sky is not
    sigmas = 2.0  # [standard deviations] from its mean to a Gaussian's surface
    # share of the mesh's extent; small Gaussians farther from the surface are floaters and stay still
    floater_share = 0.06
    surface = sigmas * scales.max(axis=1).astype(np.float64)
    result: Float64[np.ndarray, " G"] = np.clip(surface, floater_share * extent, inside_share * extent)
    return result


def bind_to_faces(
    cloud: GaussianCloud, mesh: Surface, faces: Int32[np.ndarray, " G"], weights: Float32[np.ndarray, "G 3"]
) -> Binding:
    """Bind each Gaussian to a given face, such as the one from which it was created."""
    rolled = longest_edge_first(mesh.vertices, mesh.faces)
    shift = np.argmax(rolled[:, :1] == mesh.faces, axis=1)  # [F]
    rolled_weights = np.take_along_axis(weights, (shift[faces][:, None] + np.arange(3)) % 3, axis=1)
    return _compact(cloud, mesh.vertices, rolled, faces, np.ascontiguousarray(rolled_weights))


def solid_faces(mesh: Surface) -> Int32[np.ndarray, "U 3"]:
    """Return the faces that have an area.

    Raises:
        InputError: no face has an area.
    """
    faces = mesh.faces[_is_solid(mesh.vertices, mesh.faces)]
    if len(faces) == 0:
        raise InputError(f"none of the mesh's {mesh.num_faces} faces has an area; a face to hang on is needed")
    result: Int32[np.ndarray, "U 3"] = faces
    return result


def longest_edge_first(
    vertices: Float32[np.ndarray, "N 3"], faces: Int32[np.ndarray, "F 3"]
) -> Int32[np.ndarray, "F 3"]:
    """Rotate each face's corners, with the same orientation, so that the longest edge comes first."""
    corners = vertices[faces]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)  # lengths of edges 01, 12, 20
    start = np.argmax(lengths, axis=1)
    return np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1).astype(np.int32)


def _is_solid(vertices: Float32[np.ndarray, "N 3"], faces: Int32[np.ndarray, "F 3"]) -> Bool[np.ndarray, " F"]:
    thinnest = 1e-4  # height of a face over its longest edge; thinner faces have no stable orientation
    corners = vertices[longest_edge_first(vertices, faces)].astype(np.float64)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(first, second), axis=1)
    result: Bool[np.ndarray, " F"] = area > thinnest * (first * first).sum(axis=1)
    return result


def _compact(
    cloud: GaussianCloud,
    vertices: Float32[np.ndarray, "N 3"],
    triangles: Int32[np.ndarray, "F 3"],
    face_of: Int32[np.ndarray, " G"],
    weights: Float32[np.ndarray, "G 3"],
) -> Binding:
    """Remove triangles without Gaussians."""
    used, row = np.unique(face_of[face_of != STILL], return_inverse=True)
    compacted = np.full(len(face_of), STILL, np.int32)
    compacted[face_of != STILL] = row
    return Binding(
        cloud=cloud,
        vertices=vertices,
        triangles=np.ascontiguousarray(triangles[used]),
        face_of=compacted,
        weights=np.where((face_of != STILL)[:, None], weights, 0).astype(np.float32),
    )
