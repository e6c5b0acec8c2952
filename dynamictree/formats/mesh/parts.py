"""Join the parts of a file into one mesh, in their order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from dynamictree.formats.origin import offset_warnings, shift_to_origin
from dynamictree.mesh import Material, MeshLook, Parts, TriangleMesh
from dynamictree.source import Source


@dataclass(frozen=True, kw_only=True)
class MeshPart:
    """One primitive of a file; `vertices_of` is the earlier part whose vertices it uses, if it has none of its own."""

    vertices: Float64[np.ndarray, "N 3"]
    faces: Int32[np.ndarray, "F 3"]
    uv: Float32[np.ndarray, "N 2"] | None
    vertex_colors: UInt8[np.ndarray, "N 4"] | None
    material: int  # -1: none
    vertices_of: int | None = None
    normals: Float32[np.ndarray, "N 3"] | None = None
    name: str = ""  # path of its node


def join_parts(parts: Sequence[MeshPart], materials: tuple[Material, ...]) -> TriangleMesh:
    """Join parts into one mesh; missing materials and colours become white, missing texture coordinates 0."""
    white = 255
    default_material = Material(name="default", base_color=(1.0, 1.0, 1.0, 1.0), double_sided=False)
    own, starts = [part for part in parts if part.vertices_of is None], first_vertices(parts)
    has_normals = any(p.normals is not None for p in own)
    normals = [np.zeros(p.vertices.shape, np.float32) if p.normals is None else p.normals for p in own]
    has_uv, has_colors = any(p.uv is not None for p in own), any(p.vertex_colors is not None for p in own)
    uv = [np.zeros((len(p.vertices), 2), np.float32) if p.uv is None else p.uv for p in own]
    colors = [
        np.full((len(p.vertices), 4), white, np.uint8) if p.vertex_colors is None else p.vertex_colors for p in own
    ]
    default = len(materials)
    face_material = [np.full(len(p.faces), p.material if p.material >= 0 else default, np.int32) for p in parts]
    names = tuple(dict.fromkeys(part.name for part in parts))
    face_part = [np.full(len(part.faces), names.index(part.name), np.int32) for part in parts] if any(names) else None
    vertices, offset = shift_to_origin(np.concatenate([part.vertices for part in own]))
    return TriangleMesh(
        parts=Parts(names=names if face_part else (), of_face=np.concatenate(face_part) if face_part else None),
        vertices=vertices,
        source=Source(up_axis="+Z", offset=offset),
        warnings=offset_warnings(offset),
        faces=np.concatenate([part.faces + np.int32(start) for part, start in zip(parts, starts, strict=True)]),
        look=MeshLook(
            uv=np.concatenate(uv) if has_uv else None,
            vertex_colors=np.concatenate(colors) if has_colors else None,
            normals=np.concatenate(normals) if has_normals else None,
            face_material=None if not materials else np.concatenate(face_material),
            materials=(*materials, default_material) if materials and any(p.material < 0 for p in parts) else materials,
        ),
    )


def first_vertices(parts: Sequence[MeshPart]) -> list[int]:
    """Return the index of each part's first vertex in the joined mesh."""
    starts: list[int] = []
    total = 0
    for part in parts:
        starts.append(total if part.vertices_of is None else starts[part.vertices_of])
        total += len(part.vertices) if part.vertices_of is None else 0
    return starts
