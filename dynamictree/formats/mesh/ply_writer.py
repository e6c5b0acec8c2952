"""Meshes as binary PLY: metres, +Z up, texture coordinates as s and t, colours as bytes."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float32

from dynamictree.byte_stream import ByteWriter
from dynamictree.formats.ply_table import axis_comments
from dynamictree.mesh import TriangleMesh


def write_ply(mesh: TriangleMesh, stream: ByteWriter) -> None:
    """Write vertices, texture coordinates, colours and faces; PLY stores no materials."""
    stream.write(ply_head(mesh))
    stream.write(ply_vertices(mesh, mesh.vertices))
    stream.write(ply_faces(mesh))


def ply_head(mesh: TriangleMesh) -> bytes:
    """Return the header, with the up axis and the unit in comments."""
    lines = ["ply", "format binary_little_endian 1.0", *axis_comments("+Z", 1.0, mesh.source.offset)]
    lines += [f"element vertex {mesh.num_vertices}"]
    lines += [f"property float {name}" for name in "xyz"]
    lines += [f"property float {name}" for name in "st" if mesh.look.uv is not None]
    lines += [
        f"property uchar {name}" for name in ("red", "green", "blue", "alpha") if mesh.look.vertex_colors is not None
    ]
    lines += [f"element face {mesh.num_faces}", "property list uchar int vertex_indices", "end_header"]
    return "\n".join(lines).encode() + b"\n"


def ply_vertices(mesh: TriangleMesh, positions: Float32[np.ndarray, "N 3"]) -> bytes:
    """Return the rows of the mesh's vertices at new positions."""
    fields: list[tuple[str, str, tuple[int]]] = [("position", "<f4", (3,))]
    fields += [("uv", "<f4", (2,))] if mesh.look.uv is not None else []
    fields += [("color", "u1", (4,))] if mesh.look.vertex_colors is not None else []
    rows = np.empty(mesh.num_vertices, fields)
    rows["position"] = positions
    if mesh.look.uv is not None:
        rows["uv"] = mesh.look.uv * np.array([1, -1], np.float32) + np.array([0, 1], np.float32)  # t upward
    if mesh.look.vertex_colors is not None:
        rows["color"] = mesh.look.vertex_colors
    return rows.tobytes()


def ply_faces(mesh: TriangleMesh) -> bytes:
    """Return the rows of the mesh's triangles."""
    rows = np.empty(mesh.num_faces, [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, mesh.faces
    return rows.tobytes()


def iter_ply_files(
    mesh: TriangleMesh, frames: Iterable[Float32[np.ndarray, "N 3"]], *, first_number: int = 0
) -> Iterator[tuple[str, tuple[bytes, ...]]]:
    """Yield name and content, in parts, of frame_0000.ply, …; `frames` are displacements [m], consumed one by one.

    The files are binary little-endian, in metres, +Z up, in the input's vertex order.
    """
    head, faces = ply_head(mesh), ply_faces(mesh)
    for number, displacement in enumerate(frames, first_number):
        yield f"frame_{number:04d}.ply", (head, ply_vertices(mesh, mesh.vertices + displacement), faces)
