"""`mesh.safetensors`: a `TriangleMesh` with its materials and textures, as one process hands it to another.

Internal: written by the process that parses an upload, read by those that must not parse it again.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from jaxtyping import Shaped
from safetensors import SafetensorError
from safetensors.numpy import load, save

from dynamictree.byte_stream import ByteReader, ByteWriter, read_all
from dynamictree.errors import FormatError
from dynamictree.mesh import (
    Material,
    MeshLook,
    Parts,
    SourceGltf,
    SourceWarning,
    StillPart,
    TriangleMesh,
    validate_mesh,
)
from dynamictree.source import Source

VERSION = 1
MAX_BYTES = 1 << 30


def write_mesh_bundle(mesh: TriangleMesh, stream: ByteWriter) -> None:
    """Write everything that the mesh holds."""
    tensors = {"vertices": mesh.vertices, "faces": mesh.faces}
    optional = {
        "uv": mesh.look.uv,
        "vertex_colors": mesh.look.vertex_colors,
        "face_material": mesh.look.face_material,
        "normals": mesh.look.normals,
        "face_part": mesh.parts.of_face,
        "still_faces": mesh.still_faces,
        "face_tree": mesh.face_tree,
    }
    tensors |= {name: tensor for name, tensor in optional.items() if tensor is not None}
    for index, material in enumerate(mesh.look.materials):
        if material.texture_png is not None:
            tensors[f"texture_{index}"] = np.frombuffer(material.texture_png, np.uint8)
    rest = {
        "version": VERSION,
        "materials": [asdict(replace(material, texture_png=None)) for material in mesh.look.materials],
        "source_up_axis": mesh.source.up_axis,
        "source_up_confidence": mesh.source.up_confidence,
        "source_scale": mesh.source.scale,
        "source_offset": mesh.source.offset,
        "warnings": [asdict(warning) for warning in mesh.warnings],
        "part_names": mesh.parts.names,
        "still_parts": [asdict(part) for part in mesh.parts.still],
    }
    if mesh.gltf is not None:
        tensors |= _source_tensors(mesh.gltf)
    tensors["rest"] = np.frombuffer(json.dumps(rest).encode(), np.uint8)
    stream.write(save({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}))


def read_mesh_bundle(stream: ByteReader, *, with_source: bool = False) -> TriangleMesh:
    """Undo `write_mesh_bundle`; the document that the mesh was read from is large and only for writers of GLB.

    Raises:
        FormatError: it is no such file, or of another version.
        MeshError: the mesh in it cannot be used.
    """
    try:
        tensors = load(read_all(stream, MAX_BYTES))
        rest = json.loads(tensors["rest"].tobytes())
        version = rest["version"]
        if version == VERSION:
            mesh = _mesh(tensors, rest)
            if with_source and "source_document" in tensors:
                mesh = replace(mesh, gltf=_source(tensors, mesh.num_vertices))
    except (SafetensorError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise FormatError(f"not a mesh bundle: {error}") from error
    if version != VERSION:
        raise FormatError(f"the mesh bundle is of version {version}; this reader knows {VERSION}")
    return validate_mesh(mesh)


def _source_tensors(source: SourceGltf) -> dict[str, Shaped[np.ndarray, "..."]]:
    tensors: dict[str, Shaped[np.ndarray, ...]] = {
        "source_document": np.frombuffer(source.document, np.uint8),
        "source_binary": np.frombuffer(b"".join(source.binary), np.uint8),
        "source_primitives": source.primitives,
        "source_to_primitive": source.to_primitive,
    }
    return tensors | ({} if source.to_vertex is None else {"source_to_vertex": source.to_vertex})


def _source(tensors: Mapping[str, Shaped[np.ndarray, "..."]], num_vertices: int) -> SourceGltf:
    primitives, to_primitive = tensors["source_primitives"], tensors["source_to_primitive"]
    if to_primitive.shape != (len(primitives), 3, 3) or (primitives[:, 2:].sum(axis=1) > num_vertices).any():
        raise FormatError(f"the mesh bundle's source has {len(primitives)} primitives that do not fit its vertices")
    return SourceGltf(
        document=tensors["source_document"].tobytes(),
        binary=(tensors["source_binary"].tobytes(),),
        primitives=primitives,
        to_primitive=to_primitive,
        to_vertex=tensors.get("source_to_vertex"),
    )


def _mesh(tensors: Mapping[str, Shaped[np.ndarray, "..."]], rest: Mapping[str, Any]) -> TriangleMesh:
    materials = []
    for index, fields in enumerate(rest["materials"]):
        texture = tensors.get(f"texture_{index}")
        fields |= {"base_color": tuple(fields["base_color"])}
        materials.append(Material(**fields | {"texture_png": None if texture is None else texture.tobytes()}))
    return TriangleMesh(
        vertices=tensors["vertices"],
        faces=tensors["faces"],
        look=MeshLook(
            uv=tensors.get("uv"),
            vertex_colors=tensors.get("vertex_colors"),
            face_material=tensors.get("face_material"),
            normals=tensors.get("normals"),
            materials=tuple(materials),
        ),
        parts=Parts(
            names=tuple(rest.get("part_names", ())),
            of_face=tensors.get("face_part"),
            still=tuple(StillPart(**part) for part in rest.get("still_parts", ())),
        ),
        still_faces=tensors.get("still_faces"),
        face_tree=tensors.get("face_tree"),
        source=Source(
            up_axis=rest["source_up_axis"],
            up_confidence=rest.get("source_up_confidence", 1.0),
            scale=rest["source_scale"],
            offset=tuple(rest.get("source_offset", (0.0, 0.0, 0.0))),
        ),
        warnings=tuple(SourceWarning(**entry) for entry in rest.get("warnings", ())),
    )
