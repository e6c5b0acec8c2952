"""Read glTF and GLB as one mesh: parts, materials, textures, placed and instanced nodes, skins and morphs, Draco.

Vertices are ordered by node, as in the file (parents before children), then by primitive of a mesh, then as in their
accessor. Primitives of a node that share their accessors share their vertices.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import DracoPy
import numpy as np
from jaxtyping import Float32, Float64, Int32, Shaped, UInt8

from dynamictree.color import linear_to_srgb
from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.gltf.document import GltfDocument, accessor_layout, open_gltf
from dynamictree.formats.gltf.material import gltf_materials, texture_coordinates, texture_placement
from dynamictree.formats.gltf.normals import turn_normals
from dynamictree.formats.gltf.scene import MeshInstance, mesh_instances
from dynamictree.formats.gltf.source import keep_source
from dynamictree.formats.json_fields import (
    JsonObject,
    index_field,
    integer_field,
    numbers_field,
    object_field,
    object_list,
)
from dynamictree.formats.mesh.parts import MeshPart, first_vertices, join_parts
from dynamictree.mesh import MAX_FACES, MAX_VERTICES, TriangleMesh, unit_vectors

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


@dataclass(frozen=True, kw_only=True)
class _Primitive:
    """Decoded arrays of a primitive, before its node's transform."""

    attributes: Mapping[str, Shaped[np.ndarray, "n width"]]
    indices: Shaped[np.ndarray, " M"] | None


def read_gltf(content: bytes, *, companions: Mapping[str, bytes]) -> TriangleMesh:
    """Read a mesh in the file's axes and units; material indices are those of the file.

    Raises:
        FormatError: see `open_gltf`; an accessor beyond its buffer; nodes that form no tree; a damaged texture.
        MeshError: no triangles, or more than `mesh.py` allows, which is found before any is read.
    """
    document = open_gltf(content, companions=companions)
    instances = list(mesh_instances(document))
    drawn = [(instance, primitive) for instance in instances for primitive in _triangle_primitives(instance.mesh)]
    if not drawn:
        raise MeshError("the glTF file has no triangles in its scene; a mesh with faces is needed, not points or lines")
    _refuse_too_many(document, drawn)
    materials = gltf_materials(document)
    with np.errstate(over="ignore", invalid="ignore"):  # validate_mesh finds values that are not finite
        parts = _placed_parts(document, drawn)
        starts = first_vertices(parts)
        rows = [
            [instance.node, number, start, len(part.vertices)]
            for (instance, (number, _)), start, part in zip(drawn, starts, parts, strict=True)
        ]
        source = keep_source(document, np.array(rows, np.int32))
    mesh = join_parts(parts, materials)
    return replace(mesh, gltf=source, warnings=(*mesh.warnings, *document.warnings))


def _triangle_primitives(mesh: JsonObject) -> list[tuple[int, JsonObject]]:
    triangles = (_TRIANGLES, _STRIP, _FAN)
    primitives = enumerate(object_list(mesh, "primitives"))
    return [(i, p) for i, p in primitives if integer_field(p, "mode", high=6, default=_TRIANGLES) in triangles]


def _refuse_too_many(document: GltfDocument, drawn: list[tuple[MeshInstance, tuple[int, JsonObject]]]) -> None:
    """Check the numbers of vertices and faces in the JSON, instances included."""
    num_vertices, num_corners = 0, 0
    seen: set[tuple[int, int]] = set()
    for instance, (_, primitive) in drawn:
        attributes = object_field(primitive, "attributes")
        position = index_field(attributes, "POSITION", document.accessors, "accessors")
        if position is None:
            raise FormatError("a primitive of the glTF file has no POSITION")
        count = accessor_layout(document.accessors[position], f"accessors[{position}]")[0]
        num_vertices += 0 if (id(instance), position) in seen else count
        seen.add((id(instance), position))
        indices = index_field(primitive, "indices", document.accessors, "accessors")
        corners = count if indices is None else accessor_layout(document.accessors[indices], f"accessors[{indices}]")[0]
        strip = integer_field(primitive, "mode", high=6, default=_TRIANGLES) != _TRIANGLES
        num_corners += 3 * corners if strip else corners
    if num_vertices > MAX_VERTICES or num_corners > 3 * MAX_FACES:
        raise MeshError(
            f"the glTF file has {num_vertices:,} vertices and {num_corners // 3:,} faces with all instances; at most "
            f"{MAX_VERTICES:,} and {MAX_FACES:,} are allowed; decimate it first"
        )


def _placed_parts(document: GltfDocument, drawn: list[tuple[MeshInstance, tuple[int, JsonObject]]]) -> list[MeshPart]:
    """Read the parts in order, at their places."""
    parts: list[MeshPart] = []
    shared: dict[tuple[int, str, str], int] = {}
    materials = object_list(document.root, "materials")
    for instance, (_, primitive) in drawn:
        extension = object_field(primitive, "extensions").get("KHR_draco_mesh_compression")
        attributes = object_field(primitive, "attributes")
        material = index_field(primitive, "material", materials, "materials")
        placement = texture_placement({} if material is None else materials[material])
        key = (id(instance), repr(sorted(attributes.items())), placement)
        read = _read_primitive(document, primitive)
        part = _part(document, instance, primitive, read, material)
        if extension is None and key in shared:
            part = replace(part, vertices_of=shared[key])
        shared.setdefault(key, len(parts))
        parts.append(part)
    return parts


def _part(
    document: GltfDocument, instance: MeshInstance, primitive: JsonObject, read: _Primitive, material: int | None
) -> MeshPart:
    """Convert a primitive to a part at its place."""
    positions = read.attributes["POSITION"].astype(np.float64)
    if positions.shape[1] != 3:
        raise FormatError(f"POSITION has {positions.shape[1]} numbers a vertex; 3 are needed")
    targets = object_list(primitive, "targets")
    weights = numbers_field(instance.weighs, "weights", len(targets), (0.0,) * len(targets))
    for target, weight in zip(targets, weights, strict=True):
        accessor = index_field(target, "POSITION", document.accessors, "accessors")
        if weight != 0 and accessor is not None:
            offsets = document.accessor(accessor)
            if offsets.shape != positions.shape:
                raise FormatError(f"a morph target has shape {offsets.shape}; {positions.shape} is needed")
            positions += weight * offsets
    mode = integer_field(primitive, "mode", high=6, default=_TRIANGLES)
    faces = _faces(read.indices, len(positions), mode)
    turn: Float64[np.ndarray, "*n 3 3"] = instance.transform[:3, :3]
    if instance.joints is None:
        placed = positions @ turn.T + instance.transform[:3, 3]
    else:  # a skin replaces its node's transform
        matrices = _skin_matrices(read.attributes, instance.joints, len(positions))
        turn = matrices[:, :, :3]
        placed = np.einsum("nij,nj->ni", turn, positions) + matrices[:, :, 3]
    if turn.ndim == 2 and np.linalg.det(turn) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    entry = None if material is None else object_list(document.root, "materials")[material]
    return MeshPart(
        vertices=placed,
        faces=faces,
        uv=texture_coordinates(read.attributes, entry, len(positions)),
        vertex_colors=_colors(read.attributes, len(positions)),
        material=-1 if material is None else material,
        normals=_normals(read.attributes, turn, len(positions)),
        name=instance.path,
    )


def _read_primitive(document: GltfDocument, primitive: JsonObject) -> _Primitive:
    attributes = object_field(primitive, "attributes")
    extension = object_field(object_field(primitive, "extensions"), "KHR_draco_mesh_compression")
    if extension:
        return _decode_draco(document, extension)
    read = {}
    for name in attributes:
        if name.startswith(("POSITION", "NORMAL", "TEXCOORD_", "COLOR_0", "JOINTS_0", "WEIGHTS_0")):
            accessor = index_field(attributes, name, document.accessors, "accessors")
            assert accessor is not None
            read[name] = document.accessor(accessor)
    indices = index_field(primitive, "indices", document.accessors, "accessors")
    return _Primitive(attributes=read, indices=None if indices is None else document.accessor(indices)[:, 0])


def _decode_draco(document: GltfDocument, extension: JsonObject) -> _Primitive:
    view = index_field(extension, "bufferView", document.views, "bufferViews")
    if view is None:
        raise FormatError("KHR_draco_mesh_compression names no bufferView")
    try:
        mesh = DracoPy.decode(document.view_bytes(view))
    except (DracoPy.FileTypeException, ValueError, MemoryError) as error:
        raise FormatError(f"the Draco stream of a primitive cannot be decoded: {error}") from error
    if getattr(mesh, "faces", None) is None or len(mesh.faces) > MAX_FACES or len(mesh.points) > MAX_VERTICES:
        raise FormatError("the Draco stream of a primitive holds no mesh, or one that is too large")
    identities = object_field(extension, "attributes")
    read = {}
    for name in identities:
        attribute = mesh.get_attribute_by_unique_id(integer_field(identities, name, high=2**31 - 1))
        if attribute is not None and len(attribute["data"]) == len(mesh.points):
            read[name] = np.asarray(attribute["data"]).reshape(len(mesh.points), -1)
    read.setdefault("POSITION", np.asarray(mesh.points))
    return _Primitive(attributes=read, indices=np.asarray(mesh.faces).ravel())


def _faces(indices: Shaped[np.ndarray, " M"] | None, num_vertices: int, mode: int) -> Int32[np.ndarray, "F 3"]:
    if indices is None:
        indices = np.arange(num_vertices)
    if indices.dtype.kind not in "iu" or (len(indices) and int(indices.max()) >= num_vertices):
        raise FormatError(f"indices of a primitive name vertices beyond its {num_vertices}, or are no whole numbers")
    corners = indices.astype(np.int32)
    if mode == _TRIANGLES:
        return np.ascontiguousarray(corners[: len(corners) // 3 * 3].reshape(-1, 3))
    count = max(len(corners) - 2, 0)
    first, second = np.arange(count), np.arange(1, count + 1)
    if mode == _FAN:
        return np.stack([np.full(count, corners[0]) if count else first, corners[second], corners[second + 1]], 1)
    odd = first % 2  # every other triangle of a strip is wound the other way
    strip: Int32[np.ndarray, "F 3"] = np.stack([corners[first], corners[second + odd], corners[second + 1 - odd]], 1)
    return strip


def _skin_matrices(
    attributes: Mapping[str, Shaped[np.ndarray, "n width"]], joints: Float64[np.ndarray, "J 4 4"], num_vertices: int
) -> Float64[np.ndarray, "N 3 4"]:
    """Return the weighted sum of the matrices of each vertex's joints."""
    if "JOINTS_0" not in attributes or "WEIGHTS_0" not in attributes:
        raise FormatError("a skinned primitive has no JOINTS_0 or WEIGHTS_0")
    rows, weights = attributes["JOINTS_0"].astype(np.int64), attributes["WEIGHTS_0"].astype(np.float64)
    if rows.shape != weights.shape or len(rows) != num_vertices or (rows.size and rows.max() >= len(joints)):
        raise FormatError(f"a skinned primitive names joints beyond its {len(joints)}, or not for each vertex")
    matrices = np.zeros((num_vertices, 3, 4))
    for i in range(rows.shape[1]):
        matrices += weights[:, i, None, None] * joints[rows[:, i], :3]
    return matrices


def _normals(
    attributes: Mapping[str, Shaped[np.ndarray, "n width"]], matrices: Float64[np.ndarray, "*n 3 3"], count: int
) -> Float32[np.ndarray, "N 3"] | None:
    """Return NORMAL, turned by the node or the skin; 0 where it has no direction."""
    if "NORMAL" not in attributes:
        return None
    stored = attributes["NORMAL"].astype(np.float64)
    if stored.shape != (count, 3):
        raise FormatError(f"NORMAL has shape {list(stored.shape)}; {[count, 3]} is needed")
    return turn_normals(unit_vectors(stored), matrices)


def _colors(attributes: Mapping[str, Shaped[np.ndarray, "n width"]], count: int) -> UInt8[np.ndarray, "N 4"] | None:
    """Convert COLOR_0, which is linear, to sRGB."""
    if "COLOR_0" not in attributes:
        return None
    stored = attributes["COLOR_0"]
    if stored.shape[0] != count or stored.shape[1] not in (3, 4):
        raise FormatError(f"COLOR_0 has shape {list(stored.shape)}; {count} rows of 3 or 4 are needed")
    scale = 1.0 if stored.dtype.kind == "f" else 1.0 / np.iinfo(stored.dtype).max
    linear = np.clip(np.nan_to_num(stored.astype(np.float32) * np.float32(scale)), 0, 1)
    rgba = np.ones((count, 4), np.float32)
    rgba[:, : linear.shape[1]] = linear
    rgba[:, :3] = linear_to_srgb(rgba[:, :3])
    return np.asarray(np.round(rgba * 255), np.uint8)
