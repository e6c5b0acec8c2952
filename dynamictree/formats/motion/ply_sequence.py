"""A mesh's motion as one PLY per frame."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float32

from dynamictree.formats.mesh.ply_writer import ply_faces, ply_head, ply_vertices
from dynamictree.mesh import TriangleMesh


def iter_ply_files(
    mesh: TriangleMesh, frames: Iterable[Float32[np.ndarray, "N 3"]], *, first_number: int = 0
) -> Iterator[tuple[str, tuple[bytes, ...]]]:
    """Yield name and content, in parts, of frame_0000.ply, …; `frames` are displacements [m], consumed one by one.

    The files are binary little-endian, in metres, +Z up, in the input's vertex order.
    """
    head, faces = ply_head(mesh), ply_faces(mesh)
    for number, displacement in enumerate(frames, first_number):
        yield f"frame_{number:04d}.ply", (head, ply_vertices(mesh, mesh.vertices + displacement), faces)
