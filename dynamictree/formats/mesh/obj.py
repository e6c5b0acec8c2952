"""Wavefront OBJ with its MTL and textures, which are looked up only among the files that were sent along.

Vertices follow the `v` lines. A vertex with several texture coordinates or normals retains its first; copies with the
others follow after the last `v`. Polygons are cut into fans.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64, UInt8

from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.companions import find_companion
from dynamictree.formats.texture import refuse_many_pixels, texture_as_png
from dynamictree.mesh import MAX_FACES, MAX_VERTICES, Material, SourceWarning, TriangleMesh, unit_vectors

_CUTOFF = 0.5  # of a material with a map_d


@dataclass(kw_only=True)
class _Statements:
    """The lines of a file by their keyword, corners and faces still text."""

    vertices: list[bytes] = field(default_factory=list)
    texture_places: list[bytes] = field(default_factory=list)
    normals: list[bytes] = field(default_factory=list)
    corners: list[tuple[bytes, int, int, int]] = field(default_factory=list)  # token, number of v, vt, vn lines above
    face_sizes: list[int] = field(default_factory=list)
    face_materials: list[int] = field(default_factory=list)
    material_names: dict[str, int] = field(default_factory=dict)
    face_parts: list[int] = field(default_factory=list)
    part_names: dict[str, int] = field(default_factory=dict)  # of objects and groups
    libraries: list[str] = field(default_factory=list)


def read_obj(content: bytes, *, companions: Mapping[str, bytes]) -> TriangleMesh:
    """Read, in the file's own axes and units. A library or texture that was not sent along leaves its default.

    Raises:
        FormatError: a line that cannot be read, a face that names what is not there, a damaged texture.
        MeshError: no faces, or more than `mesh.py` allows.
    """
    lines = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    statements = _sort_lines(lines)
    if not statements.face_sizes:
        raise MeshError(
            f"the OBJ file has {len(statements.vertices):,} vertices and no faces; a triangle mesh is needed"
        )
    if not statements.vertices:
        raise FormatError("the OBJ file has faces but no vertices; it is damaged")
    table = _numbers(statements.vertices, "v", (3, 4, 6, 7))
    places = _numbers(statements.texture_places, "vt", (1, 2, 3)) if statements.texture_places else None
    directions = _directions(statements.normals)
    counts = (len(table), 0 if places is None else len(places), len(directions))
    rows, place_rows, normal_rows = _corner_rows(statements, counts)
    original, looks, corners = _split(rows, np.stack([place_rows, _alike(directions)[normal_rows]], 1), len(table))
    faces, source_face = fans(corners, np.array(statements.face_sizes))
    warnings: list[SourceWarning] = []
    materials = _materials(statements, companions, warnings)
    uv = None
    if places is not None:
        uv = np.zeros((len(original), 2), np.float32)
        placed = looks[:, 0] >= 0
        uv[placed, : min(places.shape[1], 2)] = places[looks[placed, 0], :2]
        uv[placed, 1] = 1 - uv[placed, 1]  # v upward in OBJ
    return TriangleMesh(
        vertices=table[original, :3].astype(np.float32),
        faces=faces,
        uv=uv,
        vertex_colors=_colors(table, original),
        normals=_normals(directions, looks[:, 1]),
        face_material=np.array(statements.face_materials, np.int32)[source_face] if materials else None,
        materials=materials,
        part_names=(*statements.part_names, "") if statements.part_names else (),
        face_part=_parts(statements)[source_face] if statements.part_names else None,
        warnings=tuple(warnings),
    )


def _parts(statements: _Statements) -> Int32[np.ndarray, " P"]:
    """The part of each polygon; those above the first name are of the last, which has none."""
    part = np.array(statements.face_parts, np.int32)
    return np.where(part < 0, len(statements.part_names), part).astype(np.int32)


def _sort_lines(lines: list[bytes]) -> _Statements:
    lines_by_kind = _Statements()
    material, part = -1, -1
    num_triangles = 0
    for line in lines:
        keyword, _, rest = line.strip().partition(b" ")
        if keyword == b"v":
            lines_by_kind.vertices.append(rest)
        elif keyword == b"vt":
            lines_by_kind.texture_places.append(rest)
        elif keyword == b"vn":
            lines_by_kind.normals.append(rest)
        elif keyword == b"f":
            tokens = rest.split()
            if len(tokens) < 3:
                raise FormatError(f"a face of the OBJ file has {len(tokens)} corners; at least 3 are needed")
            num_triangles += len(tokens) - 2
            if num_triangles > MAX_FACES or len(lines_by_kind.vertices) > MAX_VERTICES:
                raise MeshError(
                    f"the OBJ file has more than {MAX_FACES:,} triangles or {MAX_VERTICES:,} vertices; decimate it"
                )
            above = (len(lines_by_kind.vertices), len(lines_by_kind.texture_places), len(lines_by_kind.normals))
            lines_by_kind.corners += [(token, *above) for token in tokens]
            lines_by_kind.face_sizes.append(len(tokens))
            if material < 0:
                material = lines_by_kind.material_names.setdefault("", len(lines_by_kind.material_names))
            lines_by_kind.face_materials.append(material)
            lines_by_kind.face_parts.append(part)
        elif keyword == b"usemtl":
            name = _text(rest.strip())[:200]
            material = lines_by_kind.material_names.setdefault(name, len(lines_by_kind.material_names))
        elif keyword in (b"o", b"g"):
            name = _text(rest.strip())[:200]
            part = lines_by_kind.part_names.setdefault(name, len(lines_by_kind.part_names))
        elif keyword == b"mtllib":
            lines_by_kind.libraries.append(_text(rest.strip()))
    return lines_by_kind


def _text(content: bytes) -> str:
    """UTF-8, or Latin-1 as programs on Windows write names with umlauts."""
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _numbers(lines: list[bytes], keyword: str, widths: tuple[int, ...]) -> Float64[np.ndarray, "n width"]:
    width = len(lines[0].split())
    tokens = b" ".join(lines).split()
    if width not in widths or len(tokens) != width * len(lines):
        odd = next((i for i, line in enumerate(lines) if len(line.split()) != width), 0)
        raise FormatError(
            f"line {odd + 1} of the `{keyword}` lines of the OBJ file is {lines[odd][:60]!r}; "
            f"{', '.join(map(str, widths))} numbers are allowed, the same on all lines"
        )
    try:
        return np.array(tokens, dtype=np.bytes_).astype(np.float64).reshape(-1, width)
    except ValueError as error:
        raise FormatError(f"a `{keyword}` line of the OBJ file holds what is no number: {error}") from error


def _corner_rows(
    statements: _Statements, counts: tuple[int, int, int]
) -> tuple[Int64[np.ndarray, " C"], Int64[np.ndarray, " C"], Int64[np.ndarray, " C"]]:
    """Row of the vertex, the texture place and the normal of every corner; -1 where it has none."""
    resolved: dict[tuple[bytes, int, int, int], tuple[int, int, int]] = {}
    rows = np.empty((len(statements.corners), 3), np.int64)
    for i, corner in enumerate(statements.corners):
        token, *above = corner
        key = corner if b"-" in token else (token, 0, 0, 0)  # negative numbers count back from where they stand
        if key not in resolved:
            parts = [*token.split(b"/"), b"", b""]
            vertex = _resolve(parts[0], above[0], counts[0], token)
            place = _resolve(parts[1], above[1], counts[1], token) if parts[1] else -1
            resolved[key] = (vertex, place, _normal_row(parts[2], above[2], counts[2]))
        rows[i] = resolved[key]
    return rows[:, 0], rows[:, 1], rows[:, 2]


def _normal_row(number: bytes, above: int, count: int) -> int:
    """As `_resolve`, but -1 for what is not there: a shape needs no normals."""
    try:
        return _resolve(number, above, count, number)
    except FormatError:
        return -1


def _directions(lines: list[bytes]) -> Float64[np.ndarray, "n 3"]:
    """The `vn` lines; none where they cannot be read, as a shape needs no normals."""
    try:
        return _numbers(lines, "vn", (3,)) if lines else np.zeros((0, 3))
    except FormatError:
        return np.zeros((0, 3))


def _resolve(number: bytes, above: int, count: int, token: bytes) -> int:
    digits = number.removeprefix(b"-")
    if not digits.isdigit() or len(digits) > 9:
        raise FormatError(f"a face of the OBJ file has the corner {token[:40]!r}, which is not understood")
    row = above - int(digits) if number.startswith(b"-") else int(digits) - 1
    if not 0 <= row < count:
        raise FormatError(f"a face of the OBJ file has the corner {token[:40]!r}, but there are {count} to choose from")
    return row


def _alike(directions: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " m"]:
    """Of each normal, the first that is the same within a degree; -1 after the last, for corners without one."""
    units = np.round(unit_vectors(directions).astype(np.float64), 2) if len(directions) else directions
    _, first, inverse = np.unique(units, axis=0, return_index=True, return_inverse=True)
    return np.append(first[inverse.ravel()], -1).astype(np.int64)


def _split(
    rows: Int64[np.ndarray, " C"], looks: Int64[np.ndarray, "C 2"], num_vertices: int
) -> tuple[Int64[np.ndarray, " N"], Int64[np.ndarray, "N 2"], Int32[np.ndarray, " C"]]:
    """Source row, and texture place and normal, of each vertex that is made, and the vertex at each corner."""
    keys, first, inverse = np.unique(np.column_stack([rows, looks]), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")  # in the order of faces
    owner = np.full(num_vertices, -1, np.int64)
    vertex, position = np.unique(keys[order, 0], return_index=True)
    owner[vertex] = order[position]  # the look that a vertex came with first
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


def fans(
    corners: Int32[np.ndarray, " C"], sizes: Int64[np.ndarray, " P"]
) -> tuple[Int32[np.ndarray, "F 3"], Int64[np.ndarray, " F"]]:
    """Triangles of polygons that lie one after the other, and the polygon of each."""
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


def _colors(table: Float64[np.ndarray, "n width"], rows: Int64[np.ndarray, " N"]) -> UInt8[np.ndarray, "N 4"] | None:
    """Colours after the position, in [0, 1], as some scanners write them."""
    if table.shape[1] < 6:
        return None
    rgb = np.clip(np.nan_to_num(table[rows, -3:]), 0, 1)
    return np.concatenate([np.round(rgb * 255), np.full((len(rows), 1), 255)], axis=1).astype(np.uint8)


def _materials(
    statements: _Statements, companions: Mapping[str, bytes], warnings: list[SourceWarning]
) -> tuple[Material, ...]:
    if set(statements.material_names) == {""}:
        return ()
    described: dict[str, Material] = {}
    for library in statements.libraries:
        content = find_companion(library, companions)
        if content is None:
            message = f"material library {library[:120]!r} was not sent along; its materials are grey"
            warnings.append(SourceWarning(code="material-library-missing", message=message))
        else:
            described |= _read_mtl(content, companions, warnings)
    return tuple(described.get(name, Material(name=name)) for name in statements.material_names)


def _read_mtl(content: bytes, companions: Mapping[str, bytes], warnings: list[SourceWarning]) -> dict[str, Material]:
    fields: dict[str, dict[str, str]] = {}
    current: dict[str, str] = {}
    for line in _text(content).splitlines():
        keyword, _, rest = line.strip().partition(" ")
        if keyword == "newmtl":
            current = fields.setdefault(rest.strip()[:200], {})
        elif keyword:
            current[keyword] = rest.strip()
    images: dict[str, bytes] = {}
    return {name: _material(name, entry, companions, images, warnings) for name, entry in fields.items()}


def _material(
    name: str,
    entry: Mapping[str, str],
    companions: Mapping[str, bytes],
    images: dict[str, bytes],
    warnings: list[SourceWarning],
) -> Material:
    """Build one material; `images` has the textures that are decoded already."""
    red, green, blue = _floats(entry.get("Kd", "0.8 0.8 0.8"), 3, "Kd")
    opaque = _floats(entry["d"], 1, "d")[0] if "d" in entry else 1 - _floats(entry.get("Tr", "0"), 1, "Tr")[0]
    texture = entry.get("map_Kd", "")
    content = find_companion(texture, companions)  # names may have spaces
    if content is None:
        texture = texture.split(" ")[-1]  # options come before it
        content = find_companion(texture, companions)
    if texture and content is None:
        message = f"texture {texture[:120]!r} was not sent along; the model is used without it"
        if message not in (warning.message for warning in warnings):
            warnings.append(SourceWarning(code="texture-missing", message=message))
    if content is not None and texture not in images:
        images[texture] = texture_as_png(content, texture[:80])
        refuse_many_pixels(images.values())
    return Material(
        name=name,
        base_color=(red, green, blue, opaque),
        texture_png=images.get(texture),
        alpha_cutoff=_CUTOFF if "map_d" in entry else None,
    )


def _floats(text: str, count: int, keyword: str) -> list[float]:
    try:
        values = [float(token) for token in text.split()[:count]]
    except ValueError as error:
        raise FormatError(f"{keyword} of a material is {text[:60]!r}; {count} numbers are needed") from error
    if len(values) != count:
        raise FormatError(f"{keyword} of a material is {text[:60]!r}; {count} numbers are needed")
    return [min(max(value, 0.0), 1.0) for value in values]
