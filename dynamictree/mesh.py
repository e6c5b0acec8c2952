"""Triangle meshes in memory: metres, +Z up, right-handed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, Int32, UInt8

from dynamictree.errors import MeshError
from dynamictree.source import METRES_Z_UP, Source

if TYPE_CHECKING:
    import trimesh

MAX_VERTICES = 2_000_000
MAX_FACES = 4_000_000
MAX_EXTENT_RATIO = 1e6
MAX_MATERIALS = 10_000
"""Limits of meshes that are read: two cores voxelise them in seconds, float32 resolves them, and a reader has enough
memory (100,000 materials took 3 GiB; a mesh of one tree has up to some hundreds)."""


@dataclass(frozen=True, kw_only=True)
class Material:
    """Material of faces: the base colour of glTF's metallic-roughness model."""

    name: str = ""
    base_color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)  # linear RGBA in [0, 1]
    texture_png: bytes | None = None  # sRGB image that multiplies base_color, or None
    alpha_cutoff: float | None = None  # alpha below which a face is cut out; None is opaque
    double_sided: bool = True
    blended: bool = False  # written files use alpha blending in place of the cutoff


@dataclass(frozen=True, kw_only=True)
class SourceWarning:
    """Warning of a reader that skipped or assumed something; docs/formats.md lists the codes."""

    code: str
    message: str


@dataclass(frozen=True, kw_only=True)
class SourceGltf:
    """glTF document that a mesh was read from; a writer adds the motion to it and changes nothing else."""

    document: bytes  # JSON; its one buffer is `binary`
    binary: tuple[bytes, ...]
    primitives: Int32[np.ndarray, "P 4"]  # node, primitive of the node's mesh, first vertex, number of vertices


@dataclass(frozen=True, kw_only=True)
class StillPart:
    """Part that stands still because it was detected as no plant, and the reason."""

    name: str
    why: str


@dataclass(frozen=True, kw_only=True)
class MeshLook:
    """Appearance of a surface: texture coordinates, colours, materials and shading normals; None where absent."""

    uv: Float32[np.ndarray, "N 2"] | None = None  # texture coordinates, v downward as in glTF
    vertex_colors: UInt8[np.ndarray, "N 4"] | None = None  # sRGB and alpha
    face_material: Int32[np.ndarray, " F"] | None = None  # index into materials
    materials: tuple[Material, ...] = ()
    normals: Float32[np.ndarray, "N 3"] | None = None  # unit normals of the source; 0 where it has none

    def of(self, vertices: Int[np.ndarray, " n"], faces: Bool[np.ndarray, " F"]) -> "MeshLook":
        """Return the look of the selected vertices and faces."""
        return MeshLook(
            uv=None if self.uv is None else self.uv[vertices],
            vertex_colors=None if self.vertex_colors is None else self.vertex_colors[vertices],
            face_material=None if self.face_material is None else self.face_material[faces],
            materials=self.materials,
            normals=None if self.normals is None else self.normals[vertices],
        )


@dataclass(frozen=True, kw_only=True)
class Parts:
    """Named parts of a mesh, and those that were detected as no plant."""

    names: tuple[str, ...] = ()  # paths of nodes or groups: "Pot/Cylinder"
    of_face: Int32[np.ndarray, " F"] | None = None  # index into names
    still: tuple[StillPart, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Geometry of a mesh and the faces that may move: the input of voxels, motion and binding."""

    vertices: Float32[np.ndarray, "N 3"]  # rest positions [m]
    faces: Int32[np.ndarray, "F 3"]
    still_faces: Bool[np.ndarray, " F"] | None = None  # faces of no plant, such as a pot; None if all may move
    face_tree: Int32[np.ndarray, " F"] | None = None  # index of the face's tree; -1 for still faces

    @property
    def moving_part(self) -> "Surface":
        """The same vertices with only the faces that may move."""
        if self.still_faces is None:
            return self
        moves = ~self.still_faces
        tree = None if self.face_tree is None else np.maximum(self.face_tree[moves], 0)
        return Surface(vertices=self.vertices, faces=self.faces[moves], face_tree=tree)

    @property
    def still_vertices(self) -> Bool[np.ndarray, " N"]:
        """Mask of the vertices that only still faces use."""
        still = np.zeros(self.num_vertices, np.bool_)
        if self.still_faces is not None:
            still[self.faces[self.still_faces]] = True
            still[self.faces[~self.still_faces]] = False
        return still

    @property
    def num_vertices(self) -> int:
        """Number of vertices, N."""
        return len(self.vertices)

    @property
    def num_faces(self) -> int:
        """Number of faces, F."""
        return len(self.faces)

    @property
    def height_m(self) -> float:
        """Extent along +Z [m]."""
        return float(np.ptp(self.vertices[:, 2]))

    @property
    def height_text(self) -> str:
        """The height with its unit."""
        return f"{self.height_m:.3g} m" if self.height_m < 1000 else f"{self.height_m:,.0f} m"


@dataclass(frozen=True, kw_only=True)
class TriangleMesh(Surface):
    """Surface with its look and source. The vertex order is the source's; displacement files follow it."""

    look: MeshLook = MeshLook()
    parts: Parts = Parts()
    source: Source = METRES_Z_UP
    warnings: tuple[SourceWarning, ...] = ()
    gltf: SourceGltf | None = None  # set for glTF as long as its vertices are where the file has them

    @property
    def moving_part(self) -> "TriangleMesh":
        """The same vertices with only the faces that may move."""
        if self.still_faces is None:
            return self
        moves, rest = ~self.still_faces, super().moving_part
        material = None if self.look.face_material is None else self.look.face_material[moves]
        return replace(
            self,
            faces=rest.faces,
            still_faces=None,
            face_tree=rest.face_tree,
            look=replace(self.look, face_material=material),
            parts=replace(self.parts, of_face=None if self.parts.of_face is None else self.parts.of_face[moves]),
            gltf=None,
        )

    @staticmethod
    def from_trimesh(source: "trimesh.Trimesh | trimesh.Scene") -> "TriangleMesh":
        """Convert a mesh or scene of trimesh, which must be in metres and +Z up; the vertex order stays.

        Raises:
            MeshError: no triangles, or a mesh that the method cannot work on.
        """
        import trimesh

        if isinstance(source, trimesh.Scene):
            nodes = [
                (source.graph[node][0], source.geometry[source.graph[node][1]]) for node in source.graph.nodes_geometry
            ]
            parts = [_from_trimesh(g, placed) for placed, g in nodes if isinstance(g, trimesh.Trimesh)]
        else:
            parts = [_from_trimesh(source, np.eye(4))]
        if not parts:
            raise MeshError("the scene has no triangles; a mesh with faces is needed, not points or lines")
        return join_meshes(parts)

    @property
    def material_of_face(self) -> Int32[np.ndarray, " F"]:
        """Index of each face's material; 0 where the mesh has none."""
        return np.zeros(self.num_faces, np.int32) if self.look.face_material is None else self.look.face_material

    def with_vertices(self, vertices: Float32[np.ndarray, "N 3"]) -> "TriangleMesh":
        """Return the mesh with new positions, in the same order [m]."""
        return replace(self, vertices=vertices, look=replace(self.look, normals=None), gltf=None)


AnyMesh: TypeAlias = "TriangleMesh | trimesh.Trimesh | trimesh.Scene"


def triangle_mesh(mesh: AnyMesh) -> TriangleMesh:
    """Return the mesh, converted if it is an object of trimesh."""
    return mesh if isinstance(mesh, TriangleMesh) else TriangleMesh.from_trimesh(mesh)


def validate_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh if the method can work on it.

    Raises:
        MeshError: no faces, non-finite positions, an index out of range, no extent, or a limit exceeded.
    """
    if mesh.num_faces == 0 or mesh.num_vertices < 3:
        counts = f"{mesh.num_vertices} vertices and {mesh.num_faces} faces"
        raise MeshError(f"the mesh has {counts}; at least 3 vertices and 1 triangle are needed")
    if mesh.num_vertices > MAX_VERTICES or mesh.num_faces > MAX_FACES:
        counts = f"{mesh.num_vertices:,} vertices and {mesh.num_faces:,} faces"
        allowed = f"at most {MAX_VERTICES:,} and {MAX_FACES:,} are allowed"
        raise MeshError(f"the mesh has {counts}; {allowed}; decimate it first")
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


def refuse_many_materials(count: int) -> None:
    """Check the number of materials before any is read.

    Raises:
        MeshError: there are more than `MAX_MATERIALS`.
    """
    if count > MAX_MATERIALS:
        raise MeshError(f"the file has {count:,} materials; at most {MAX_MATERIALS:,} are allowed; merge them")


def vertex_normals(vertices: Float64[np.ndarray, "N 3"], faces: Int32[np.ndarray, "F 3"]) -> Float64[np.ndarray, "N 3"]:
    """Sum the area-weighted normals of the faces around each vertex; not of unit length."""
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    crosses = np.cross(b - a, c - a)  # [F, 3], the length is twice the area
    normals = np.zeros_like(vertices)
    for axis in range(3):
        for corner in range(3):
            normals[:, axis] += np.bincount(faces[:, corner], crosses[:, axis], minlength=len(vertices))
    return normals


def unit_vectors(vectors: Float[np.ndarray, "N 3"]) -> Float32[np.ndarray, "N 3"]:
    """Normalise vectors; components that are not finite count as 0, and a zero vector stays 0."""
    sound = np.nan_to_num(vectors, nan=0.0, posinf=0.0, neginf=0.0)
    length = np.linalg.norm(sound, axis=1, keepdims=True)
    return np.asarray(sound / np.where(length > 0, length, 1), np.float32)


def edges_of(faces: Int32[np.ndarray, "F 3"]) -> Int32[np.ndarray, "E 2"]:
    """Return every edge once, the lower vertex first, in ascending order."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])  # [3F, 2]
    pairs = np.sort(pairs, axis=1)
    keys = np.unique(pairs[:, 0].astype(np.int64) << 32 | pairs[:, 1])
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32)


def weld(mesh: Surface) -> tuple[Surface, Int32[np.ndarray, " N"]]:
    """Merge vertices at identical positions, which files split at seams of texture or shading.

    Returns:
        The bare surface, sorted by position, and the new index of each vertex of the mesh.
    """
    order = np.lexsort(mesh.vertices.T[::-1])
    places, vertex = mesh.vertices[order], np.zeros(mesh.num_vertices, np.int32)
    first = np.ones(len(places), np.bool_)
    first[1:] = (places[1:] != places[:-1]).any(axis=1)
    vertex[order] = np.cumsum(first) - 1
    return Surface(vertices=places[first], faces=vertex[mesh.faces]), vertex


def connected_parts(faces: Int32[np.ndarray, "F 3"], num_vertices: int) -> Int32[np.ndarray, " N"]:
    """Label each vertex with the index of its connected component."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = np.repeat(faces[:, 0], 2), faces[:, 1:].ravel()
    joined = coo_array((np.ones(len(pairs[0])), pairs), shape=(num_vertices, num_vertices))
    return np.asarray(connected_components(joined, directed=False)[1], np.int32)


def part_bounds(
    part: Int[np.ndarray, " N"], points: Float[np.ndarray, "N 3"]
) -> tuple[Float64[np.ndarray, "parts 3"], Float64[np.ndarray, "parts 3"]]:
    """Return the low and high corner of the points of each part [m]."""
    order = np.argsort(part, kind="stable")
    present, start = np.unique(part[order], return_index=True)
    low, high = np.full((int(part.max()) + 1, 3), np.inf), np.full((int(part.max()) + 1, 3), -np.inf)
    low[present], high[present] = (each.reduceat(points[order], start) for each in (np.minimum, np.maximum))
    return low, high


def _from_trimesh(source: "trimesh.Trimesh", placed: Float64[np.ndarray, "4 4"]) -> TriangleMesh:
    """Convert one mesh of a scene, moved to its place, with its texture or colours."""
    vertices = (np.asarray(source.vertices) @ placed[:3, :3].T + placed[:3, 3]).astype(np.float32)
    faces = np.asarray(source.faces, np.int32)
    if np.linalg.det(placed[:3, :3]) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    visual = source.visual
    if visual.kind == "texture":
        stored = visual.uv if visual.uv is not None and len(visual.uv) == len(vertices) else None
        uv = None if stored is None else (np.asarray(stored) * [1, -1] + [0, 1]).astype(np.float32)
        material = _from_trimesh_material(visual.material, textured=uv is not None)
        face_material = np.zeros(len(faces), np.int32)
        look = MeshLook(uv=uv, face_material=face_material, materials=(material,))
        return TriangleMesh(vertices=vertices, faces=faces, look=look)
    colors = np.asarray(visual.vertex_colors, np.uint8) if visual.kind in ("vertex", "face") else None
    return TriangleMesh(vertices=vertices, faces=faces, look=MeshLook(vertex_colors=colors))


def _from_trimesh_material(source: "trimesh.visual.material.Material", *, textured: bool) -> Material:
    if hasattr(source, "to_pbr"):
        source = source.to_pbr()
    factor = getattr(source, "baseColorFactor", None)
    rgba = np.ones(4) if factor is None else np.asarray(factor, float) / (255 if np.max(factor) > 1 else 1)
    image = getattr(source, "baseColorTexture", None) if textured else None
    png = None
    if image is not None:
        stream = BytesIO()
        image.convert("RGBA" if "A" in image.getbands() else "RGB").save(stream, "PNG")
        png = stream.getvalue()
    mode = getattr(source, "alphaMode", None)
    return Material(
        name=str(source.name or "")[:200],
        base_color=(float(rgba[0]), float(rgba[1]), float(rgba[2]), float(rgba[3]) if len(rgba) > 3 else 1.0),
        texture_png=png,
        alpha_cutoff=0.5 if mode in ("MASK", "BLEND") else None,
    )


def join_meshes(parts: Sequence[TriangleMesh]) -> TriangleMesh:
    """Concatenate meshes; missing texture coordinates become 0, missing colours and materials white."""
    materials: list[Material] = []
    face_material, starts = list[Int32[np.ndarray, " F"]](), np.cumsum([0, *(part.num_vertices for part in parts)])
    for part in parts:
        face_material.append(np.full(part.num_faces, len(materials), np.int32))
        materials += part.look.materials or (
            Material(name="default", base_color=(1.0, 1.0, 1.0, 1.0), double_sided=False),
        )
    uv = [np.zeros((p.num_vertices, 2), np.float32) if p.look.uv is None else p.look.uv for p in parts]
    white = [
        np.full((p.num_vertices, 4), 255, np.uint8) if p.look.vertex_colors is None else p.look.vertex_colors
        for p in parts
    ]
    has_materials = any(part.look.materials for part in parts)
    return TriangleMesh(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([p.faces + np.int32(start) for p, start in zip(parts, starts, strict=False)]),
        look=MeshLook(
            uv=np.concatenate(uv) if any(part.look.uv is not None for part in parts) else None,
            vertex_colors=np.concatenate(white) if any(part.look.vertex_colors is not None for part in parts) else None,
            face_material=np.concatenate(face_material) if has_materials else None,
            materials=tuple(materials) if has_materials else (),
        ),
    )
