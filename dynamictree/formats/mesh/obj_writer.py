"""Meshes as OBJ text with an MTL beside it: metres, +Z up, in the mesh's vertex order."""

import numpy as np

from dynamictree.byte_stream import ByteWriter
from dynamictree.mesh import TriangleMesh


def write_obj(mesh: TriangleMesh, stream: ByteWriter, *, library: str = "") -> dict[str, bytes]:
    """Write the mesh; gives the files that `library` stands for, the MTL and its textures, by name.

    Positions have nine digits, which is what float32 needs to come back the same.
    """
    lines = [f"mtllib {library}"] if library else []
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices.tolist()]
    has_uv = mesh.uv is not None
    if mesh.uv is not None:
        lines += [f"vt {u:.9g} {1 - v:.9g}" for u, v in mesh.uv.tolist()]
    face_material = np.zeros(mesh.num_faces, np.int32) if mesh.face_material is None else mesh.face_material
    current = -1
    for face, material in zip((mesh.faces + 1).tolist(), face_material.tolist(), strict=True):
        if mesh.materials and material != current:
            lines.append(f"usemtl {_name(mesh, material)}")
            current = material
        lines.append("f " + " ".join(f"{corner}/{corner}" if has_uv else str(corner) for corner in face))
    stream.write("\n".join(lines).encode() + b"\n")
    return _library(mesh, library) if library else {}


def _name(mesh: TriangleMesh, material: int) -> str:
    return mesh.materials[material].name.strip() or f"material_{material}"


def _library(mesh: TriangleMesh, library: str) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    lines: list[str] = []
    for number, material in enumerate(mesh.materials):
        red, green, blue, alpha = material.base_color
        lines += [f"newmtl {_name(mesh, number)}", f"Kd {red:.6g} {green:.6g} {blue:.6g}", f"d {alpha:.6g}"]
        if material.texture_png is not None:
            texture = f"{library.removesuffix('.mtl')}_{number}.png"
            files[texture] = material.texture_png
            lines += [f"map_Kd {texture}"] + ([f"map_d {texture}"] if material.alpha_cutoff is not None else [])
    return files | {library: ("\n".join(lines) + "\n").encode()}
