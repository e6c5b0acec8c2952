"""`*.vertex-motion.safetensors`: the motion of a mesh's vertices, from which every product is written. Internal."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.formats.tensors.container import read_tensors, take_tensor, write_tensors

FORMAT, VERSION = "vertex-motion", "1"


@dataclass(frozen=True, kw_only=True)
class VertexMotion:
    """Spectra of the vertices of one mesh [m]."""

    linear: Complex64[np.ndarray, "N K 3"]  # as interpolated from voxels
    bent: Complex64[np.ndarray, "N L 3"] | None = None
    """Of a large motion, the loop without stretch; L is K or, where K frequencies would stretch, more."""

    @property
    def coefficients(self) -> Complex64[np.ndarray, "N K 3"]:
        """What products show."""
        return self.linear if self.bent is None else np.ascontiguousarray(self.bent[:, : self.linear.shape[1]])

    @property
    def loop(self) -> Complex64[np.ndarray, "N L 3"]:
        """What a product shows that adds frequencies and cannot bend."""
        return self.linear if self.bent is None else self.bent


def write_vertex_motion(motion: VertexMotion, stream: ByteWriter) -> None:
    """Write; undone bit by bit by `read_vertex_motion`."""
    tensors = {"linear": motion.linear} if motion.bent is None else {"linear": motion.linear, "bent": motion.bent}
    parts = {name: np.ascontiguousarray(values).view(np.float32) for name, values in tensors.items()}
    write_tensors(stream, parts, {"format": FORMAT, "version": VERSION})


def read_vertex_motion(stream: ByteReader) -> VertexMotion:
    """Read.

    Raises:
        FormatError: the file is no motion of vertices of a known version.
    """
    tensors, _ = read_tensors(stream, file_format=FORMAT, version=VERSION)
    spectra = {
        name: take_tensor(tensors, name, dtypes=("float32",), shape=(None, None, 6)).view(np.complex64)
        for name in tensors
    }
    return VertexMotion(**spectra)
