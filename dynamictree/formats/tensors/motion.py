"""`motion.safetensors`: a mesh and the displacement of its vertices at every frame, in the input's vertex order."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.errors import FormatError
from dynamictree.formats.tensors.container import file_head, number, read_tensors, take_tensor
from dynamictree.mesh import Surface

FORMAT = "tree-motion"
VERSION = "1"
MAX_FILE_BYTES = 1 << 34  # 600 frames of 2 million vertices


@dataclass(frozen=True, kw_only=True)
class MeshMotion:
    """A moving mesh; frame n is `vertices + displacement[n]` at time n / fps. Metres, +Z up."""

    vertices: Float32[np.ndarray, "N 3"]
    faces: Int32[np.ndarray, "F 3"]
    displacement: Float32[np.ndarray, "T N 3"]
    fps: float


def write_motion(
    mesh: Surface, frames: Iterable[Float32[np.ndarray, "N 3"]], stream: ByteWriter, *, num_frames: int, fps: float
) -> None:
    """Write frame after frame as they come, never the whole motion in memory."""
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


def read_motion(stream: ByteReader) -> MeshMotion:
    """Read; undoes `write_motion` bit by bit.

    Raises:
        FormatError: the file is no motion of a known version, or anything in it is out of range.
    """
    tensors, metadata = read_tensors(stream, file_format=FORMAT, version=VERSION, max_bytes=MAX_FILE_BYTES)
    vertices = take_tensor(tensors, "vertices", dtypes=("float32",), shape=(None, 3))
    faces = take_tensor(tensors, "faces", dtypes=("int32",), shape=(None, 3))
    displacement = take_tensor(tensors, "displacement", dtypes=("float32",), shape=(None, len(vertices), 3))
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise FormatError(f"a face of the motion names a vertex beyond its {len(vertices):,}")
    return MeshMotion(vertices=vertices, faces=faces, displacement=displacement, fps=number(metadata, "fps"))
