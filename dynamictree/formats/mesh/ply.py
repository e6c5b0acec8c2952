"""PLY meshes, ASCII and binary of both byte orders. Vertices keep the file's order; polygons become triangle fans."""

import io
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32, Shaped, UInt8

from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.companions import find_companion
from dynamictree.formats.mesh.obj import fan_triangles
from dynamictree.formats.origin import offset_warnings, shift_to_origin
from dynamictree.formats.ply_table import read_header, read_polygons
from dynamictree.formats.texture import texture_as_png
from dynamictree.mesh import MAX_FACES, MAX_VERTICES, Material, MeshLook, TriangleMesh, unit_vectors
from dynamictree.source import Source

_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_LIST_NAMES = ("vertex_indices", "vertex_index")


def read_ply_mesh(content: bytes, *, companions: Mapping[str, bytes]) -> TriangleMesh:
    """Read a mesh in the file's axes and units.

    Raises:
        FormatError: not PLY, shorter than its header says, no faces (a point cloud or a splat), a damaged texture.
        MeshError: more than `mesh.py` allows, found in the header.
    """
    stream = io.BytesIO(content)
    header = read_header(stream)
    vertex, face = header.element("vertex"), header.element("face")
    if vertex is None or not {"x", "y", "z"} <= vertex.names:
        raise FormatError("the PLY file has no vertices with x, y and z")
    if face is None or face.count == 0:
        kind = "3D Gaussian splat" if {"f_dc_0", "rot_0"} <= vertex.names else "point cloud"
        raise FormatError(
            f"the PLY file is a {kind} of {vertex.count:,} points without faces; a triangle mesh is needed "
            "(OBJ, STL, glTF, GLB, or PLY with faces)"
        )
    if vertex.count > MAX_VERTICES or face.count > MAX_FACES:
        raise MeshError(
            f"the PLY file has {vertex.count:,} vertices and {face.count:,} faces; at most {MAX_VERTICES:,} and "
            f"{MAX_FACES:,} are allowed; decimate it first"
        )
    rows, corners, sizes = read_polygons(stream, header, _LIST_NAMES)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(rows)):
        raise FormatError(f"a face of the PLY file names a vertex beyond its {len(rows):,}")
    faces, _ = fan_triangles(corners, sizes)
    if len(faces) > MAX_FACES:
        raise MeshError(f"the PLY file has {len(faces):,} triangles; {MAX_FACES:,} are allowed; decimate it first")
    material = _material(content, companions)
    vertices, offset = shift_to_origin(np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1))
    return TriangleMesh(
        vertices=vertices,
        faces=faces,
        look=MeshLook(
            uv=_uv(rows),
            vertex_colors=_colors(rows),
            normals=_normals(rows),
            face_material=np.zeros(len(faces), np.int32) if material else None,
            materials=(material,) if material else (),
        ),
        source=Source(up_axis="+Z", offset=offset),
        warnings=offset_warnings(offset),
    )


def _uv(rows: Shaped[np.ndarray, " N"]) -> Float32[np.ndarray, "N 2"] | None:
    names = set(rows.dtype.names or ())
    pair = next((pair for pair in _UV_NAMES if set(pair) <= names), None)
    if pair is None:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack([rows[pair[0]].astype(np.float32), 1 - rows[pair[1]].astype(np.float32)], axis=1)


def _normals(rows: Shaped[np.ndarray, " N"]) -> Float32[np.ndarray, "N 3"] | None:
    if not {"nx", "ny", "nz"} <= set(rows.dtype.names or ()):
        return None
    return unit_vectors(np.stack([rows[name].astype(np.float64) for name in ("nx", "ny", "nz")], axis=1))


def _colors(rows: Shaped[np.ndarray, " N"]) -> UInt8[np.ndarray, "N 4"] | None:
    names = set(rows.dtype.names or ())
    if not {"red", "green", "blue"} <= names:
        return None
    colors = np.full((len(rows), 4), 255, np.uint8)
    for i, name in enumerate(("red", "green", "blue", "alpha")):
        if name in names:
            values = rows[name]
            scaled = np.nan_to_num(values.astype(np.float64)) * (255 if values.dtype.kind == "f" else 1)
            colors[:, i] = np.round(np.clip(scaled, 0, 255))
    unset = ~colors.any(axis=1)  # 0 0 0 0: Blender writes it for objects without colours beside others that have some
    colors[unset] = 255
    return None if unset.all() else colors


def _material(content: bytes, companions: Mapping[str, bytes]) -> Material | None:
    """Return the material of the texture that `comment TextureFile` names, if it was uploaded."""
    for line in content[:65_536].partition(b"end_header")[0].splitlines():
        words = line.decode("latin-1").split(maxsplit=2)
        if words[:2] == ["comment", "TextureFile"] and len(words) == 3:
            name = words[2].strip()
            picture = find_companion(name, companions)
            if picture is None:
                continue
            texture = texture_as_png(picture, name[:80])
            return Material(name=name[:200], base_color=(1.0, 1.0, 1.0, 1.0), texture_png=texture)
    return None
