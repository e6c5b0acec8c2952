"""A mesh's motion as one PLY a frame in a ZIP that streams."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float32

from dynamictree.formats.mesh.ply_writer import ply_faces, ply_head, ply_vertices
from dynamictree.formats.stored_zip import iter_stored_zip
from dynamictree.mesh import TriangleMesh


def iter_ply_sequence_zip(
    mesh: TriangleMesh, frames: Iterable[Float32[np.ndarray, "N 3"]], *, first_number: int = 0
) -> Iterator[bytes]:
    """Chunks of the archive; `frames` are displacements [m] and are asked for one by one.

    Entries are frame_0000.ply and so on: binary little-endian, metres, +Z up, in the input's vertex order.
    """
    head, faces = ply_head(mesh), ply_faces(mesh)
    yield from iter_stored_zip(
        (f"frame_{number:04d}.ply", (head, ply_vertices(mesh, mesh.vertices + displacement), faces))
        for number, displacement in enumerate(frames, first_number)
    )
