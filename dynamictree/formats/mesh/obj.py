"""Wavefront OBJ with its MTL and textures, which are looked up only among the files that were sent along.

Vertices have the order of the `v` lines. A vertex with several texture coordinates or normals retains its first; copies
with the others follow after the last `v`. Polygons become triangle fans; points, lines and 2-corner faces are skipped.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64, UInt8

from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.mesh.mtl import read_materials, text_of
from dynamictree.formats.number_text import numbers_of
from dynamictree.formats.origin import offset_warnings, shift_to_origin
from dynamictree.mesh import (
    MAX_FACES,
    MAX_VERTICES,
    Material,
    MeshLook,
    Parts,
    SourceWarning,
    TriangleMesh,
    unit_vectors,
)
from dynamictree.source import Source

_CONTINUED = re.compile(rb"\\[ \t]*\r?\n")
_FACE = re.compile(rb"((-?[0-9]{1,18})(/(-?[0-9]{1,18})?){0,2} )+")
_UNREADABLE_NORMAL = re.compile(rb"(/[^/ ]*/)(?!-?[0-9]+ )[^ ]*")


@dataclass(kw_only=True)
class _Statements:
    """Lines of a file by keyword; their numbers are not parsed yet."""

    vertices: list[bytes] = field(default_factory=list)
    texture_places: list[bytes] = field(default_factory=list)
    normals: list[bytes] = field(default_factory=list)
    faces: list[bytes] = field(default_factory=list)  # corners as "v/vt/vn ", 0 for a missing number
    face_sizes: list[int] = field(default_factory=list)
    above: dict[int, tuple[int, int, int]] = field(default_factory=dict)  # counts of v, vt, vn before a relative face
    face_materials: list[int] = field(default_factory=list)
    material_names: dict[str, int] = field(default_factory=dict)
    face_parts: list[int] = field(default_factory=list)
    part_names: dict[str, int] = field(default_factory=dict)  # names of objects and groups
    libraries: list[str] = field(default_factory=list)


def read_obj(content: bytes, *, companions: Mapping[str, bytes]) -> TriangleMesh:
    """Read a mesh in the file's axes and units; defaults replace a library or texture that was not sent along.

    Raises:
        FormatError: a line that cannot be read, a face with an index out of range, a damaged texture.
        MeshError: no faces, or more than `mesh.py` allows.
    """
    statements = _sort_lines(_CONTINUED.sub(b" ", content.removeprefix(b"\xef\xbb\xbf")).splitlines())
    if not statements.face_sizes:
        raise MeshError(
            f"the OBJ file has {len(statements.vertices):,} vertices and no faces; a triangle mesh is needed"
        )
    if not statements.vertices:
        raise FormatError("the OBJ file has faces but no vertices; it is damaged")
    table, widths = _numbers(statements.vertices, "v", 3)
    places = _numbers(statements.texture_places, "vt", 1)[0]
    directions = _directions(statements.normals)
    rows = _corner_rows(statements, (len(table), len(places), len(directions)))  # [C, 3]
    looks = np.stack([rows[:, 1], _merge_normals(directions)[rows[:, 2]]], 1)
    original, looks, corners = _split_corners(rows[:, 0], looks, len(table))
    faces, source_face = fan_triangles(corners, np.array(statements.face_sizes))
    materials: tuple[Material, ...] = ()
    warnings: list[SourceWarning] = []
    if set(statements.material_names) != {""}:
        materials, warnings = read_materials(tuple(statements.material_names), statements.libraries, companions)
    vertices, offset = shift_to_origin(table[:, :3])
    part = np.array(statements.face_parts, np.int32)
    part[part < 0] = len(statements.part_names)  # faces above the first name belong to a last, unnamed part
    return TriangleMesh(
        vertices=vertices[original],
        faces=faces,
        look=MeshLook(
            uv=_uv(places, looks[:, 0]),
            vertex_colors=_colors(table, widths, original),
            normals=_normals(directions, looks[:, 1]),
            face_material=np.array(statements.face_materials, np.int32)[source_face] if materials else None,
            materials=materials,
        ),
        parts=Parts(
            names=(*statements.part_names, "") if statements.part_names else (),
            of_face=part[source_face] if statements.part_names else None,
        ),
        source=Source(up_axis="+Z", offset=offset),
        warnings=(*warnings, *offset_warnings(offset)),
    )


def _sort_lines(lines: list[bytes]) -> _Statements:
    statements = _Statements()
    numbers = {b"v": statements.vertices, b"vt": statements.texture_places, b"vn": statements.normals}
    material, part, num_triangles = -1, -1, 0
    for line in lines:
        keyword, rest = (*line.split(None, 1), b"", b"")[:2]
        if not rest:
            continue
        if keyword in numbers:
            numbers[keyword].append(rest.partition(b"#")[0])
        elif keyword in (b"f", b"fo"):
            corners = rest.partition(b"#")[0].split()
            if len(corners) < 3:
                continue
            num_triangles += len(corners) - 2
            if num_triangles > MAX_FACES or len(statements.vertices) > MAX_VERTICES:
                raise MeshError(
                    f"the OBJ file has more than {MAX_FACES:,} triangles or {MAX_VERTICES:,} vertices; decimate it"
                )
            if b"-" in rest:
                above = (len(statements.vertices), len(statements.texture_places), len(statements.normals))
                statements.above[len(statements.faces)] = above
            statements.faces.append(_three_numbers(corners))
            statements.face_sizes.append(len(corners))
            if material < 0:
                material = statements.material_names.setdefault("", len(statements.material_names))
            statements.face_materials.append(material)
            statements.face_parts.append(part)
        elif keyword == b"usemtl":
            name = text_of(rest.strip())[:200]
            material = statements.material_names.setdefault(name, len(statements.material_names))
        elif keyword in (b"o", b"g"):
            name = text_of(rest.strip())[:200]
            part = statements.part_names.setdefault(name, len(statements.part_names))
        elif keyword == b"mtllib":
            statements.libraries.append(text_of(rest.strip()))
    return statements


def _three_numbers(corners: list[bytes]) -> bytes:
    """Return the corners with 0 for each missing number."""
    given = {corner.count(b"/") for corner in corners}
    if len(given) > 1:
        return b"".join(corner + b"/0" * (2 - corner.count(b"/")) + b" " for corner in corners)
    end = b"/0" * (2 - given.pop()) + b" "
    return end.join(corners) + end


def _numbers(
    lines: list[bytes], keyword: str, fewest: int
) -> tuple[Float64[np.ndarray, "n w"], Int64[np.ndarray, " n"]]:
    """Parse lines to a table, padded with NaN, and count the numbers per line."""
    if not lines:
        return np.zeros((0, fewest)), np.zeros(0, np.int64)
    widths = np.fromiter((len(line.split()) for line in lines), np.int64, len(lines))
    values = numbers_of(b" ".join(lines).replace(b",", b"."))  # some programs write decimal commas
    if values is None or len(values) != widths.sum() or widths.min() < fewest:
        odd = next((line for line in lines if not _is_row(line, fewest)), lines[0])
        raise FormatError(f"a `{keyword}` line of the OBJ file is {odd[:60]!r}; {fewest} numbers or more are needed")
    table = np.full((len(lines), int(widths.max())), np.nan)
    table[np.arange(table.shape[1]) < widths[:, None]] = values
    return table, widths


def _is_row(line: bytes, fewest: int) -> bool:
    values = numbers_of(line.replace(b",", b"."))
    return values is not None and len(values) >= fewest


def _directions(lines: list[bytes]) -> Float64[np.ndarray, "n 3"]:
    """Parse the `vn` lines; empty if they cannot be read, as normals are optional."""
    try:
        return _numbers(lines, "vn", 3)[0][:, :3]
    except FormatError:
        return np.zeros((0, 3))


def _corner_numbers(text: bytes) -> Int64[np.ndarray, " n"] | None:
    """Parse corners such as `1/2/3`, with 0 for missing numbers; None if anything is not a number."""
    return numbers_of(text.replace(b"//", b"/0/").replace(b"/ ", b"/0 ").replace(b"/", b" "), np.int64)


def _corner_rows(statements: _Statements, counts: tuple[int, int, int]) -> Int64[np.ndarray, "C 3"]:
    """Return the row of each corner's vertex, texture coordinates and normal; -1 where it has none."""
    text, sizes = b"".join(statements.faces), np.array(statements.face_sizes)
    numbers = _corner_numbers(text)
    if numbers is None:  # normals are optional
        numbers = _corner_numbers(_UNREADABLE_NORMAL.sub(rb"\g<1>0", text))
    if numbers is None or len(numbers) != 3 * sizes.sum():
        odd = next((face for face in statements.faces if not _FACE.fullmatch(face)), b"")
        raise FormatError(f"a face of the OBJ file is {odd[:60]!r}, which is not understood")
    rows = numbers.reshape(-1, 3)
    if statements.above:  # negative numbers count back from their line
        above = np.zeros((len(sizes), 3), np.int64)
        above[list(statements.above)] = list(statements.above.values())
        rows = np.where(rows < 0, rows + np.repeat(above, sizes, axis=0) + 1, rows)
    stated = numbers.reshape(-1, 3) != 0
    beyond = (rows < 1) | (rows > counts)
    wrong = beyond[:, 0] | (beyond[:, 1] & stated[:, 1])
    if wrong.any():
        corner = "/".join(map(str, numbers.reshape(-1, 3)[int(np.argmax(wrong))]))
        raise FormatError(
            f"a face of the OBJ file has the corner {corner}, but there are {counts[0]:,} vertices and {counts[1]:,} "
            "texture coordinates to choose from"
        )
    rows[beyond] = 0  # texture coordinates and normals that do not exist
    return rows - 1


def _merge_normals(directions: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " m"]:
    """Map each normal to the first that is equal within a degree; a last entry of -1 is for corners without one."""
    units = np.round(unit_vectors(directions).astype(np.float64), 2) if len(directions) else directions
    _, first, inverse = np.unique(units, axis=0, return_index=True, return_inverse=True)
    return np.append(first[inverse.ravel()], -1).astype(np.int64)


def _split_corners(
    rows: Int64[np.ndarray, " C"], looks: Int64[np.ndarray, "C 2"], num_vertices: int
) -> tuple[Int64[np.ndarray, " N"], Int64[np.ndarray, "N 2"], Int32[np.ndarray, " C"]]:
    """Return each new vertex's source row, its texture and normal rows, and the new vertex of each corner."""
    keys, first, inverse = np.unique(np.column_stack([rows, looks]), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")  # order of first use by faces
    owner = np.full(num_vertices, -1, np.int64)
    vertex, position = np.unique(keys[order, 0], return_index=True)
    owner[vertex] = order[position]  # first look of each vertex
    is_copy = np.ones(len(keys), bool)
    is_copy[owner[vertex]] = False
    copies = order[is_copy[order]]
    if num_vertices + len(copies) > MAX_VERTICES:
        raise MeshError(f"the OBJ file needs {num_vertices + len(copies):,} vertices; {MAX_VERTICES:,} are allowed")
    vertex_of_key = np.empty(len(keys), np.int32)
    vertex_of_key[owner[vertex]] = vertex
    vertex_of_key[copies] = num_vertices + np.arange(len(copies))
    looks_of = np.full((num_vertices + len(copies), 2), -1, np.int64)
    looks_of[vertex_of_key] = keys[:, 1:]
    return np.concatenate([np.arange(num_vertices), keys[copies, 0]]), looks_of, vertex_of_key[inverse.ravel()]


def fan_triangles(
    corners: Int32[np.ndarray, " C"], sizes: Int64[np.ndarray, " P"]
) -> tuple[Int32[np.ndarray, "F 3"], Int64[np.ndarray, " F"]]:
    """Split concatenated polygons into triangle fans; return the triangles and the polygon of each."""
    polygon = np.repeat(np.arange(len(sizes)), sizes - 2)
    start = (np.cumsum(sizes) - sizes)[polygon]
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    faces = np.stack([corners[start], corners[start + step + 1], corners[start + step + 2]], axis=1)
    return faces.astype(np.int32), polygon


def _normals(
    directions: Float64[np.ndarray, "n 3"], rows: Int64[np.ndarray, " N"]
) -> Float32[np.ndarray, "N 3"] | None:
    stated = rows >= 0
    if not stated.any():
        return None
    normals = np.zeros((len(rows), 3), np.float32)
    normals[stated] = unit_vectors(directions)[rows[stated]]
    return normals


def _uv(places: Float64[np.ndarray, "n w"], rows: Int64[np.ndarray, " N"]) -> Float32[np.ndarray, "N 2"] | None:
    """Return texture coordinates with v downward; 0 where a vertex has none."""
    if not len(places):
        return None
    uv = np.zeros((len(rows), 2), np.float32)
    placed = rows >= 0
    uv[placed, : min(places.shape[1], 2)] = np.nan_to_num(places[rows[placed], :2])
    uv[placed, 1] = 1 - uv[placed, 1]
    return uv


def _colors(
    table: Float64[np.ndarray, "n width"], widths: Int64[np.ndarray, " n"], rows: Int64[np.ndarray, " N"]
) -> UInt8[np.ndarray, "N 4"] | None:
    """Read colours after the positions, up to 1 or to 255, as scanners write them; white where a line has none.

    If four numbers follow the position, the first is a weight if it is 1 everywhere; else the last is alpha.
    """
    colored = widths >= 6
    if not colored.any():
        return None
    first = 4 if (widths[colored] == 7).all() and (table[colored, 3] == 1).all() else 3
    rgb = np.nan_to_num(table[colored, first : first + 3])
    colors = np.full((len(table), 4), 255, np.uint8)
    colors[colored, :3] = np.round(np.clip(rgb if rgb.max() > 1 else rgb * 255, 0, 255))
    of_vertices: UInt8[np.ndarray, "N 4"] = colors[rows]
    return of_vertices
