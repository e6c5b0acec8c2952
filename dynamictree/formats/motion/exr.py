"""OpenEXR images of half floats, ZIP compressed."""

import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float16


def exr_of(pixels: Float16[np.ndarray, "H W 3"]) -> bytes:
    """Encode a linear image, first row on top."""
    import OpenEXR  # 5 MB of code, loaded only on use

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with tempfile.TemporaryDirectory(prefix="dynamictree-exr-") as folder:
        path = Path(folder) / "picture.exr"
        with OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels)}) as picture:
            picture.write(str(path))
        return path.read_bytes()
