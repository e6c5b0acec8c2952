"""OpenEXR pictures of half floats, ZIP compressed."""

import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float16

from dynamictree.byte_stream import ByteWriter


def write_exr(pixels: Float16[np.ndarray, "H W C"], stream: ByteWriter, *, channels: str = "RGB") -> None:
    """Write a linear picture, first row on top; a channel a letter, in the order of the last axis."""
    import OpenEXR  # 5 MB of code that only this needs

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with tempfile.TemporaryDirectory(prefix="dynamictree-exr-") as folder:
        path = Path(folder) / "picture.exr"
        with OpenEXR.File(header, {channels: np.ascontiguousarray(pixels)}) as picture:
            picture.write(str(path))
        stream.write(path.read_bytes())
