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
from dynamictree.mesh import Material, SourceWarning, TriangleMesh, validate_mesh

VERSION = 1
MAX_BYTES = 1 << 30
_OPTIONAL = ("uv", "vertex_colors", "face_material", "still_faces")


def write_mesh_bundle(mesh: TriangleMesh, stream: ByteWriter) -> None:
    """Write everything that the mesh holds."""
    tensors = {"vertices": mesh.vertices, "faces": mesh.faces}
    tensors |= {name: getattr(mesh, name) for name in _OPTIONAL if getattr(mesh, name) is not None}
    for index, material in enumerate(mesh.materials):
        if material.texture_png is not None:
            tensors[f"texture_{index}"] = np.frombuffer(material.texture_png, np.uint8)
    rest = {
        "version": VERSION,
        "materials": [asdict(replace(material, texture_png=None)) for material in mesh.materials],
        "source_up_axis": mesh.source_up_axis,
        "source_scale": mesh.source_scale,
        "warnings": [asdict(warning) for warning in mesh.warnings],
    }
    tensors["rest"] = np.frombuffer(json.dumps(rest).encode(), np.uint8)
    stream.write(save({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}))


def read_mesh_bundle(stream: ByteReader) -> TriangleMesh:
    """Undo `write_mesh_bundle`.

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
    except (SafetensorError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise FormatError(f"not a mesh bundle: {error}") from error
    if version != VERSION:
        raise FormatError(f"the mesh bundle is of version {version}; this reader knows {VERSION}")
    return validate_mesh(mesh)


def _mesh(tensors: Mapping[str, Shaped[np.ndarray, "..."]], rest: Mapping[str, Any]) -> TriangleMesh:
    materials = []
    for index, fields in enumerate(rest["materials"]):
        texture = tensors.get(f"texture_{index}")
        fields |= {"base_color": tuple(fields["base_color"])}
        materials.append(Material(**fields | {"texture_png": None if texture is None else texture.tobytes()}))
    return TriangleMesh(
        vertices=tensors["vertices"],
        faces=tensors["faces"],
        uv=tensors.get("uv"),
        vertex_colors=tensors.get("vertex_colors"),
        face_material=tensors.get("face_material"),
        still_faces=tensors.get("still_faces"),
        materials=tuple(materials),
        source_up_axis=rest["source_up_axis"],
        source_scale=rest["source_scale"],
        warnings=tuple(SourceWarning(**entry) for entry in rest.get("warnings", ())),
    )
