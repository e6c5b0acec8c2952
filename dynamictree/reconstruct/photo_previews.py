"""Some of the photos of a reconstruction as their cameras see them: what strokes are drawn on."""

import json
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dynamictree.formats.tensors.container import write_tensors
from dynamictree.reconstruct.views import View

PHOTO_PREVIEWS = "photos.safetensors"
MOST_PHOTOS = 24
"""One per 15° of a walk around the plant: each side of it is seen in some."""
SIDE_PX = 960
_JPEG_QUALITY = 82


def write_photo_previews(views: Sequence[View], folder: Path) -> None:
    """Write `photos.safetensors`: JPEG bytes `photo_0`, …, and their names in the metadata.

    The pictures are undistorted, and a place on one is the same share of its width and height as in `Scribble`.

    Args:
        views: all photos with a camera; at most 24 of them are written, evenly chosen.
        folder: for the file.
    """
    rows = np.unique(np.linspace(0, len(views) - 1, min(len(views), MOST_PHOTOS)).round().astype(int))
    chosen = [views[row] for row in rows]
    tensors = {f"photo_{number}": _jpeg(view.image) for number, view in enumerate(chosen)}
    names = json.dumps([view.source for view in chosen])
    with (folder / PHOTO_PREVIEWS).open("wb") as stream:
        write_tensors(stream, tensors, {"format": "tree-photos", "version": "1", "photos": names})


def _jpeg(pixels: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, " _"]:
    image = Image.fromarray(pixels)
    image.thumbnail((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)
    stream = BytesIO()
    image.save(stream, format="JPEG", quality=_JPEG_QUALITY)
    return np.frombuffer(stream.getvalue(), np.uint8)
