"""`motion.safetensors`: a mesh and the displacement of its vertices at every frame, in the input's vertex order."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float32

from dynamictree.byte_stream import ByteWriter
from dynamictree.formats.tensors.container import file_head
from dynamictree.mesh import Surface

FORMAT = "tree-motion"
VERSION = "1"


def write_motion(
    mesh: Surface, frames: Iterable[Float32[np.ndarray, "N 3"]], stream: ByteWriter, *, num_frames: int, fps: float
) -> None:
    """Write frames one by one, without the whole motion in memory."""
    shapes = {
        "vertices": ("float32", mesh.vertices.shape),
        "faces": ("int32", mesh.faces.shape),
        "displacement": ("float32", (num_frames, mesh.num_vertices, 3)),
    }
    metadata = {"format": FORMAT, "version": VERSION, "fps": repr(float(fps)), "up_axis": "+Z", "unit": "m"}
    stream.write(file_head(shapes, metadata))
    stream.write(mesh.vertices.tobytes())
    stream.write(mesh.faces.tobytes())
    num_written = 0
    for frame in frames:
        assert frame.shape == mesh.vertices.shape, frame.shape
        stream.write(frame.tobytes())
        num_written += 1
    assert num_written == num_frames, (num_written, num_frames)
