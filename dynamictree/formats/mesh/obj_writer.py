"""Meshes as OBJ text with an MTL beside it: metres, +Z up, in the mesh's vertex order."""

from collections.abc import Iterator

import numpy as np

from dynamictree.byte_stream import ByteWriter
from dynamictree.mesh import TriangleMesh


def write_obj(mesh: TriangleMesh, stream: ByteWriter, *, library: str = "") -> dict[str, bytes]:
    """Write the mesh with groups, colours and normals; return MTL and textures by name if `library` is set.

    Positions have nine digits, so that float32 values round-trip exactly.
    """
    lines = [f"mtllib {library}"] if library else []
    places = mesh.vertices.tolist()
    if mesh.look.vertex_colors is not None:
        places = np.hstack([mesh.vertices, mesh.look.vertex_colors[:, :3] / 255]).tolist()
    lines += _rows("v", places)
    corner = "{0}"
    if mesh.look.uv is not None:
        lines += _rows("vt", (mesh.look.uv * [1, -1] + [0, 1]).tolist())
        corner = "{0}/{0}"
    if mesh.look.normals is not None:
        lines += _rows("vn", mesh.look.normals.tolist())
        corner = "{0}/{0}/{0}" if mesh.look.uv is not None else "{0}//{0}"
    written: tuple[str, ...] = ()
    for face, belongs in zip((mesh.faces + 1).tolist(), _group_lines(mesh), strict=True):
        lines += [line for line in belongs if line not in written]
        written = belongs
        lines.append("f " + " ".join(corner.format(vertex) for vertex in face))
    stream.write("\n".join(lines).encode() + b"\n")
    return _library(mesh, library) if library else {}


def _rows(keyword: str, rows: list[list[float]]) -> list[str]:
    return [f"{keyword} " + " ".join(f"{number:.9g}" for number in row) for row in rows]


def _group_lines(mesh: TriangleMesh) -> Iterator[tuple[str, ...]]:
    """Yield the lines that set the group and the material of each face."""
    groups = [f"g {name}".rstrip() for name in mesh.parts.names] if mesh.parts.of_face is not None else [""]
    materials = [f"usemtl {_name(mesh, number)}" for number in range(len(mesh.look.materials))] or [""]
    group_of = np.zeros(mesh.num_faces, np.int32) if mesh.parts.of_face is None else mesh.parts.of_face
    for group, material in zip(group_of.tolist(), mesh.material_of_face.tolist(), strict=True):
        yield tuple(line for line in (groups[group], materials[material]) if line)


def _name(mesh: TriangleMesh, material: int) -> str:
    return mesh.look.materials[material].name.strip() or f"material_{material}"


def _library(mesh: TriangleMesh, library: str) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    lines: list[str] = []
    for number, material in enumerate(mesh.look.materials):
        red, green, blue, alpha = material.base_color
        lines += [f"newmtl {_name(mesh, number)}", f"Kd {red:.6g} {green:.6g} {blue:.6g}", f"d {alpha:.6g}"]
        if material.texture_png is not None:
            texture = f"{library.removesuffix('.mtl')}_{number}.png"
            files[texture] = material.texture_png
            lines += [f"map_Kd {texture}"] + ([f"map_d {texture}"] if material.alpha_cutoff is not None else [])
    return files | {library: ("\n".join(lines) + "\n").encode()}
