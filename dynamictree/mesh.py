"""Triangle meshes in memory: metres, +Z up, right-handed."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from dynamictree.errors import MeshError

MAX_VERTICES = 2_000_000
MAX_FACES = 4_000_000
MAX_EXTENT_RATIO = 1e6
"""Caps on a mesh that is read from outside: what two cores voxelise in seconds, and float32 still resolves."""


@dataclass(frozen=True, kw_only=True)
class Material:
    """What a face looks like, as far as glTF's metallic-roughness base colour tells it."""

    name: str = ""
    base_color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)  # linear RGBA in [0, 1]
    texture_png: bytes | None = None  # sRGB image that multiplies base_color, or None
    alpha_cutoff: float | None = None  # faces are cut out where alpha is below; None is opaque
    double_sided: bool = True


@dataclass(frozen=True, kw_only=True)
class TriangleMesh:
    """One mesh of one or many parts. Vertex order is the source's; displacement files follow it.

    `source_up_axis` and `source_scale` only record how the file's axes and units became metres and +Z up.
    """

    vertices: Float32[np.ndarray, "N 3"]  # rest positions [m]
    faces: Int32[np.ndarray, "F 3"]
    uv: Float32[np.ndarray, "N 2"] | None = None  # texture coordinates, v downward as in glTF
    vertex_colors: UInt8[np.ndarray, "N 4"] | None = None  # sRGB and alpha
    face_material: Int32[np.ndarray, " F"] | None = None  # index into materials
    materials: tuple[Material, ...] = field(default=())
    source_up_axis: str = "+Z"
    source_scale: float = 1.0  # metres a unit of the source

    @property
    def num_vertices(self) -> int:
        """N."""
        return len(self.vertices)

    @property
    def num_faces(self) -> int:
        """F."""
        return len(self.faces)

    @property
    def height_m(self) -> float:
        """Extent along +Z [m]."""
        return float(np.ptp(self.vertices[:, 2]))

    def with_vertices(self, vertices: Float32[np.ndarray, "N 3"]) -> "TriangleMesh":
        """Give the same mesh with other positions, in the same order [m]."""
        return replace(self, vertices=vertices)


def validate_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """Give the mesh back if the method can work on it.

    Raises:
        MeshError: no faces, a value that is not finite, a face that names no vertex, no extent, too much of anything.
    """
    if mesh.num_faces == 0 or mesh.num_vertices < 3:
        found = f"{mesh.num_vertices} vertices and {mesh.num_faces} faces"
        raise MeshError(f"the mesh has {found}; at least 3 vertices and 1 triangle are needed")
    if mesh.num_vertices > MAX_VERTICES or mesh.num_faces > MAX_FACES:
        found = f"{mesh.num_vertices:,} vertices and {mesh.num_faces:,} faces"
        allowed = f"at most {MAX_VERTICES:,} and {MAX_FACES:,} are allowed"
        raise MeshError(f"the mesh has {found}; {allowed}; decimate it first")
    finite = np.isfinite(mesh.vertices).all(axis=1)
    if not finite.all():
        index = int(np.argmin(finite))
        position = mesh.vertices[index].tolist()
        bad = int((~finite).sum())
        raise MeshError(
            f"{bad} vertices are not finite, the first is vertex {index} at {position}; remove or repair them"
        )
    if mesh.faces.min() < 0 or mesh.faces.max() >= mesh.num_vertices:
        named = int(mesh.faces.max() if mesh.faces.max() >= mesh.num_vertices else mesh.faces.min())
        raise MeshError(f"a face names vertex {named}, but the vertices are 0 to {mesh.num_vertices - 1}")
    extent = np.ptp(mesh.vertices.astype(np.float64), axis=0)
    if extent.max() <= 0:
        raise MeshError("all vertices are at one point; the mesh needs an extent")
    magnitude = float(np.abs(mesh.vertices).max())
    if magnitude > MAX_EXTENT_RATIO * extent.max():
        raise MeshError(
            f"the mesh is {extent.max():.3g} m across but lies {magnitude:.3g} m from the origin, more than "
            f"{MAX_EXTENT_RATIO:g} times its size; move it nearer to the origin"
        )
    return mesh


def edges_of(faces: Int32[np.ndarray, "F 3"]) -> Int32[np.ndarray, "E 2"]:
    """Every edge once, lower vertex first, in ascending order."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])  # [3F, 2]
    pairs = np.sort(pairs, axis=1)
    keys = np.unique(pairs[:, 0].astype(np.int64) << 32 | pairs[:, 1])
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32)


def weld(mesh: TriangleMesh) -> tuple[TriangleMesh, Int32[np.ndarray, " N"]]:
    """Make vertices at exactly one place one vertex, as files split them at seams of texture or shading.

    Returns:
        The bare surface, in the order of the places, and the vertex in it of each of the mesh's own.
    """
    places, vertex = np.unique(mesh.vertices, axis=0, return_inverse=True)
    vertex = vertex.ravel().astype(np.int32)
    return TriangleMesh(vertices=places, faces=vertex[mesh.faces]), vertex
