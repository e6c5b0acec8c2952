"""PLY meshes, ASCII and binary of both byte orders. Vertices follow the file; polygons are cut into fans."""

import io
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float32, Int32, Int64, Shaped, UInt8

from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.companions import find_companion
from dynamictree.formats.mesh.obj import fans
from dynamictree.formats.number_text import numbers_of
from dynamictree.formats.origin import near_origin, offset_warnings
from dynamictree.formats.ply_table import PlyElement, PlyHeader, read_elements, read_header
from dynamictree.formats.texture import texture_as_png
from dynamictree.mesh import MAX_FACES, MAX_VERTICES, Material, MeshLook, TriangleMesh, unit_vectors
from dynamictree.source import Source

_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_LIST_NAMES = ("vertex_indices", "vertex_index")
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


def read_ply_mesh(content: bytes, *, companions: Mapping[str, bytes]) -> TriangleMesh:
    """Read, in the file's own axes and units.

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
    names = [element.name for element in header.elements]
    if names.index("face") < names.index("vertex"):
        raise FormatError("the PLY file has its faces before its vertices; write the vertices first")
    between = header.elements[names.index("vertex") + 1 : names.index("face")]
    (rows,) = read_elements(stream, replace(header, elements=header.elements[: names.index("face")]), "vertex")
    for element in between:
        read_elements(stream, replace(header, elements=(element,)), element.name)
    corners, sizes = _read_polygons(stream, header, face)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(rows)):
        raise FormatError(f"a face of the PLY file names a vertex beyond its {len(rows):,}")
    faces, _ = fans(corners, sizes)
    if len(faces) > MAX_FACES:
        raise MeshError(f"the PLY file has {len(faces):,} triangles; {MAX_FACES:,} are allowed; decimate it first")
    material = _material(content, companions)
    vertices, offset = near_origin(np.stack([rows[name].astype(np.float64) for name in "xyz"], axis=1))
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


def _read_polygons(
    stream: io.BytesIO, header: PlyHeader, face: PlyElement
) -> tuple[Int32[np.ndarray, " C"], Int64[np.ndarray, " P"]]:
    """Corners of all polygons one after the other, and the number of corners of each."""
    kinds = dict(face.properties)
    name = next((name for name in _LIST_NAMES if kinds.get(name, "").startswith("list")), None)
    if name is None:
        raise FormatError(
            f"the faces of the PLY file have no {' or '.join(_LIST_NAMES)}; they have {sorted(kinds)[:8]}"
        )
    if header.encoding == "ascii":
        return _ascii_polygons(stream, face, name)
    order = _ORDERS[header.encoding]
    rest = stream.read()
    return _uniform_polygons(rest, face, name, order) or _mixed_polygons(rest, face, name, order)


def _uniform_polygons(
    content: bytes, face: PlyElement, name: str, order: str
) -> tuple[Int32[np.ndarray, " C"], Int64[np.ndarray, " P"]] | None:
    """Read all faces at once if every list has the length of the first; otherwise None."""
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    at = 0
    for place, (label, kind) in enumerate(face.properties):
        if kind.startswith("list"):
            _, count_type, item_type = kind.split()
            length = _list_length(content, at, np.dtype(order + count_type))
            fields += [(f"count{place}", order + count_type, ()), (label, order + item_type, (length,))]
            at += np.dtype(count_type).itemsize + length * np.dtype(item_type).itemsize
        else:
            fields.append((label, order + kind, ()))
            at += np.dtype(kind).itemsize
    if at * face.count > len(content):
        return None
    rows = np.frombuffer(content, np.dtype(fields), face.count)
    for (count_name, *_), (_, _, shape) in pairwise(fields):
        if shape and (rows[count_name] != shape[0]).any():
            return None
    length = rows[name].shape[1]
    if length < 3:
        raise FormatError(f"the faces of the PLY file have {length} corners; at least 3 are needed")
    return _as_indices(rows[name].ravel()), np.full(face.count, length, np.int64)


def _mixed_polygons(
    content: bytes, face: PlyElement, name: str, order: str
) -> tuple[Int32[np.ndarray, " C"], Int64[np.ndarray, " P"]]:
    """Read face by face, for files that mix triangles and larger polygons."""
    corners, sizes = [], np.empty(face.count, np.int64)
    layout = [
        (label, [np.dtype(order + name) for name in kind.split() if name != "list"]) for label, kind in face.properties
    ]
    at = 0
    for row in range(face.count):
        for label, types in layout:
            length = _list_length(content, at, types[0]) if len(types) == 2 else 1
            at += types[0].itemsize if len(types) == 2 else 0
            end = at + length * types[-1].itemsize
            if end > len(content):
                raise FormatError(
                    f"face {row:,} of {face.count:,} of the PLY file ends {end - len(content):,} bytes after it; "
                    "the file is truncated or its header is wrong"
                )
            if label == name:
                if length < 3:
                    raise FormatError(f"face {row} of the PLY file has {length} corners; at least 3 are needed")
                corners.append(np.frombuffer(content, types[-1], length, at))
                sizes[row] = length
            at = end
    return _as_indices(np.concatenate(corners)), sizes


def _ascii_polygons(
    stream: io.BytesIO, face: PlyElement, name: str
) -> tuple[Int32[np.ndarray, " C"], Int64[np.ndarray, " P"]]:
    corners: list[bytes] = []
    sizes = np.empty(face.count, np.int64)
    for row in range(face.count):
        words = stream.readline().split()
        at = 0
        for label, kind in face.properties:
            listed = kind.startswith("list")
            length = _whole(words[at], row) if listed and at < len(words) else 1
            at += int(listed)
            if at + length > len(words):
                raise FormatError(f"face {row} of the PLY file has {len(words)} numbers, fewer than its list says")
            if label == name:
                if length < 3:
                    raise FormatError(f"face {row} of the PLY file has {length} corners; at least 3 are needed")
                corners += words[at : at + length]
                sizes[row] = length
            at += length
    numbers = numbers_of(b" ".join(corners), np.int64)
    if numbers is None or len(numbers) != len(corners) or np.abs(numbers).max(initial=0) >= 2**31:
        raise FormatError("a face of the PLY file holds what is no index of a vertex")
    return numbers.astype(np.int32), sizes


def _whole(word: bytes, row: int) -> int:
    if not word.isdigit() or len(word) > 9:
        raise FormatError(f"face {row} of the PLY file begins with {word[:20]!r}, which is no count")
    return int(word)


def _list_length(content: bytes, at: int, dtype: np.dtype[np.generic]) -> int:
    if at + dtype.itemsize > len(content) or dtype.kind not in "iu":
        raise FormatError("the faces of the PLY file end before their count, or their count is no whole number")
    length = int(np.frombuffer(content, dtype, 1, at)[0])
    if length < 0 or length > len(content):
        raise FormatError(f"a face of the PLY file says that it has {length} corners; the file is damaged")
    return length


def _as_indices(values: Shaped[np.ndarray, " C"]) -> Int32[np.ndarray, " C"]:
    if values.dtype.kind not in "iu" or (len(values) and int(values.max()) >= 2**31):
        raise FormatError("a face of the PLY file holds what is no index of a vertex")
    return values.astype(np.int32)


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
    """Material of the texture that a `comment TextureFile` names, if it was uploaded."""
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
