"""Mesh formats that trimesh reads: OFF, 3MF and COLLADA. Counts and sizes are checked before it parses a file."""

import io
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np

from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.companions import find_companion
from dynamictree.formats.origin import offset_warnings, shift_to_origin
from dynamictree.mesh import MAX_FACES, MAX_VERTICES, TriangleMesh

_MODEL = re.compile(rb"<(?:\w+:)?model\b[^>]*\bunit\s*=\s*[\"'](\w+)[\"']")
_3MF_UNITS_M = {  # 3MF core specification 1.3, section 3.4
    b"micron": 1e-6,
    b"millimeter": 1e-3,
    b"centimeter": 1e-2,
    b"inch": 0.0254,
    b"foot": 0.3048,
    b"meter": 1.0,
}
_Names = dict[str, list[tuple[str, str]]]
_DAE_UP = re.compile(rb"<up_axis>\s*([XYZ])_UP\s*</up_axis>")
_DAE_UNIT = re.compile(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']([-+0-9.eE]+)[\"']")


@dataclass(frozen=True, kw_only=True)
class ForeignMesh:
    """Mesh in its file's axes and units, and these as the file states them; None where it does not."""

    mesh: TriangleMesh
    up_axis: str | None
    unit_m: float | None


def read_foreign_mesh(content: bytes, *, file_type: str, companions: Mapping[str, bytes]) -> ForeignMesh:
    """Read OFF, 3MF or COLLADA.

    Raises:
        FormatError: the file is damaged, too large, or declares XML entities.
        MeshError: more vertices or faces than `mesh.py` allows.
    """
    axis: str | None = None
    unit: float | None = None
    num_faces = 1
    if file_type == "off":
        num_faces = _check_off(content)
    elif file_type == "3mf":
        axis, unit = "+Z", _3MF_UNITS_M[_check_3mf(content)]
    else:
        _refuse_entities(content)
        up = _DAE_UP.search(content)
        declared = _DAE_UNIT.search(content)
        axis = "+Y" if up is None else f"+{up[1].decode()}"
        unit = _positive(declared[1]) if declared else 1.0
    mesh = _parsed(content, file_type, companions, _dae_names(content) if file_type == "dae" else {})
    if mesh.num_faces < num_faces:  # trimesh does not check the header's counts
        raise FormatError(f"the OFF header says {num_faces:,} faces, but {mesh.num_faces:,} are there; it is truncated")
    return ForeignMesh(mesh=mesh, up_axis=axis, unit_m=unit)


def _parsed(content: bytes, file_type: str, companions: Mapping[str, bytes], names: _Names) -> TriangleMesh:
    import trimesh

    class Beside(trimesh.resolvers.Resolver):  # type: ignore[misc]
        """Resolver for the files beside the model; nothing else can be opened."""

        def __init__(self) -> None:
            pass

        def get(self, name: str) -> bytes:
            content = find_companion(name, companions)
            if content is None:
                raise KeyError(name)
            return content

        def keys(self) -> list[str]:
            return list(companions)

        def namespaced(self, namespace: str) -> "Beside":
            return self

        def write(self, name: str, content: bytes) -> None:
            raise NotImplementedError

    try:
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=file_type, resolver=Beside(), process=False, maintain_order=True
        )
    except Exception as error:
        raise FormatError(f"the {file_type.upper()} file cannot be read: {str(error)[:160]}") from error
    if not any(isinstance(g, trimesh.Trimesh) and len(g.faces) for g in scene.geometry.values()):
        raise MeshError(f"the {file_type.upper()} file has no triangles; a mesh with faces is needed")
    total = sum(len(scene.geometry[scene.graph[node][1]].vertices) for node in scene.graph.nodes_geometry)
    if total > MAX_VERTICES:
        raise MeshError(f"the file has {total:,} vertices with all instances; at most {MAX_VERTICES:,} are allowed")
    _, offset = shift_to_origin(np.asarray(scene.bounds, np.float64))
    scene.apply_translation([-number for number in offset])
    mesh = TriangleMesh.from_trimesh(scene)
    mesh = replace(mesh, source=replace(mesh.source, offset=offset), warnings=offset_warnings(offset))
    geometries = [scene.graph[node][1] for node in scene.graph.nodes_geometry]
    sizes = [(name, len(scene.geometry[name].faces)) for name in geometries if hasattr(scene.geometry[name], "faces")]
    return _with_names(mesh, sizes, names)


def _with_names(mesh: TriangleMesh, sizes: list[tuple[str, int]], names: _Names) -> TriangleMesh:
    """Return the mesh with part names; `sizes` lists the geometry and number of faces of each part."""
    if not names:
        return mesh
    waiting = {geometry: list(pairs) for geometry, pairs in names.items()}
    parts = []
    for geometry, _ in sizes:
        own = geometry if geometry in waiting else geometry.rpartition("_")[0]  # trimesh numbers repeated names
        parts.append(waiting[own].pop(0) if waiting.get(own) else ("", ""))
    part_names = tuple(dict.fromkeys(name for name, _ in parts))
    numbers = np.array([part_names.index(name) for name, _ in parts], np.int32)
    materials = mesh.look.materials
    if len(materials) == len(parts):
        pairs = zip(materials, parts, strict=True)
        materials = tuple(replace(material, name=name or material.name) for material, (_, name) in pairs)
    face_part = np.repeat(numbers, [size for _, size in sizes])
    return replace(
        mesh,
        look=replace(mesh.look, materials=materials),
        parts=replace(mesh.parts, names=part_names, of_face=face_part),
    )


def _dae_names(content: bytes) -> _Names:
    """Return, by geometry id, the node path and the material of each primitive, once per instance."""
    most_names = 16  # names in a node's path, as in glTF
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise FormatError(f"the DAE file cannot be read: {str(error)[:160]}") from error
    labels = {key: one.get("name") or key for one in root.iter() if (key := one.get("id"))}
    symbols = {
        one.get("id", ""): [
            primitive.get("material", "")
            for primitive in one.iter()
            if primitive.tag.rpartition("}")[2] in ("triangles", "polylist", "polygons")
        ]
        for one in root.iterfind(".//{*}geometry")
    }
    names: _Names = {}
    waiting = [(node, "") for node in root.findall(".//{*}visual_scene/{*}node")[::-1]]
    while waiting:
        node, above = waiting.pop()
        label = (node.get("name") or node.get("id") or "").replace("/", " ")[:200]
        path = "/".join(filter(None, (*above.split("/"), label)[-most_names:]))
        waiting += [(child, path) for child in node.findall("{*}node")[::-1]]
        for placed in node.findall("{*}instance_geometry"):
            geometry = placed.get("url", "").removeprefix("#")
            bound = {
                one.get("symbol", ""): labels.get(one.get("target", "").removeprefix("#"), "")
                for one in placed.iterfind(".//{*}instance_material")
            }
            full = path if labels.get(geometry, path) in (label, geometry) else f"{path}/{labels[geometry]}"
            names.setdefault(geometry, []).extend(
                (full, bound.get(symbol, "")[:200]) for symbol in symbols.get(geometry, [])
            )
    return names


def _check_off(content: bytes) -> int:
    """Check the header and return its number of faces."""
    lines = (line.split(b"#")[0].split() for line in content[:65536].splitlines())
    words = [word for line in lines for word in line][:4]
    counts = words[1:3]
    if not words or words[0] not in (b"OFF", b"COFF") or len(counts) < 2 or not all(w.isdigit() for w in counts):
        raise FormatError("the OFF file has no counts of vertices and faces behind its first word")
    num_vertices, num_faces = (int(word) for word in counts)
    if num_vertices > MAX_VERTICES or num_faces > MAX_FACES:
        raise MeshError(
            f"the OFF header says {num_vertices:,} vertices and {num_faces:,} faces; "
            f"at most {MAX_VERTICES:,} and {MAX_FACES:,} are allowed; decimate it first"
        )
    return num_faces


def _check_3mf(content: bytes) -> bytes:
    """Check the archive's sizes and return the unit of its model."""
    max_xml_bytes = 1 << 30  # all entries of a 3MF together; the largest mesh that is allowed takes 0.5 GB
    max_ratio = 100  # largest ratio of unpacked to packed bytes
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            declared = sum(entry.file_size for entry in archive.infolist())
            if declared > min(max_xml_bytes, max_ratio * len(content)):
                raise FormatError(f"the 3MF unpacks to {declared:,} bytes; at most {max_ratio} times its size is read")
            models = [entry for entry in archive.infolist() if entry.filename.lower().endswith(".model")]
            roots = [entry for entry in models if entry.filename.lower().endswith("3d/3dmodel.model")]
            if not roots:
                raise FormatError("the archive has no 3D/3dmodel.model; it is no 3MF file")
            for entry in models:
                _refuse_entities(archive.read(entry))
            root = archive.read(roots[0])
    except (zipfile.BadZipFile, zipfile.LargeZipFile, ValueError, OSError, EOFError, RuntimeError) as error:
        raise FormatError(f"the 3MF archive cannot be read: {str(error)[:160]}") from error
    unit = _MODEL.search(root[:65536])
    name = b"millimeter" if unit is None else unit[1].lower()
    if name not in _3MF_UNITS_M:
        raise FormatError(f"the 3MF is in {name[:20]!r}; {', '.join(u.decode() for u in _3MF_UNITS_M)} are defined")
    return name


def _refuse_entities(xml: bytes) -> None:
    if b"<!ENTITY" in xml or b"<!DOCTYPE" in xml:
        raise FormatError("the XML declares entities or a document type, which models do not need; remove them")
    corners = xml.count(b"<triangle ") + xml.count(b"<tri ")
    if corners > MAX_FACES:
        raise MeshError(f"the file has {corners:,} triangles; at most {MAX_FACES:,} are allowed; decimate it first")


def _positive(text: bytes) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e6:
        raise FormatError(f"the COLLADA file has a unit of {text[:20]!r} metres; a positive length is needed")
    return value
