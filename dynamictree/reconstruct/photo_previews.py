"""Previews of a reconstruction's photos, undistorted, on which users draw strokes."""

import json
from collections.abc import Collection, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dynamictree.files import open_input
from dynamictree.formats.tensors.container import read_tensors, write_tensors
from dynamictree.reconstruct.photo_cameras import evenly_chosen
from dynamictree.reconstruct.views import View

PHOTO_PREVIEWS = "photos.safetensors"
_FORMAT, _VERSION = "tree-photos", "1"
MOST_PHOTOS = 24
"""One per 15° around the plant, so that each side is seen."""
SIDE_PX = 960


def write_photo_previews(views: Sequence[View], folder: Path, *, needed: Collection[str] = ()) -> None:
    """Write `photos.safetensors`: JPEG bytes `photo_0`, …, and their names in the metadata.

    The pictures are undistorted; a position in one, as a share of its width and height, is the same as in `Scribble`.

    Args:
        views: all photos with a camera; at most 24 of them are written, evenly chosen.
        folder: folder for the file.
        needed: names of photos that are written in any case.
    """
    named = {row for row, view in enumerate(views) if view.source in needed}
    others = [row for row in range(len(views)) if row not in named]
    chosen = [views[row] for row in sorted({*named, *evenly_chosen(others, max(MOST_PHOTOS - len(named), 0))})]
    tensors = {f"photo_{number}": _jpeg(view.image) for number, view in enumerate(chosen)}
    names = json.dumps([view.source for view in chosen])
    with (folder / PHOTO_PREVIEWS).open("wb") as stream:
        write_tensors(stream, tensors, {"format": _FORMAT, "version": _VERSION, "photos": names})


def read_photo_previews(folder: Path) -> dict[str, UInt8[np.ndarray, "H W 3"]]:
    """Read the pictures that `write_photo_previews` wrote, by photo name; none if there is no file."""
    if not (folder / PHOTO_PREVIEWS).exists():
        return {}
    with open_input(folder / PHOTO_PREVIEWS) as stream:
        tensors, metadata = read_tensors(stream, file_format=_FORMAT, version=_VERSION)
    pictures = {}
    for number, name in enumerate(json.loads(metadata["photos"])):
        with Image.open(BytesIO(tensors[f"photo_{number}"].tobytes())) as image:
            pictures[name] = np.asarray(image.convert("RGB"))
    return pictures


def _jpeg(pixels: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, " _"]:
    jpeg_quality = 82
    image = Image.fromarray(pixels)
    image.thumbnail((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)
    stream = BytesIO()
    image.save(stream, format="JPEG", quality=jpeg_quality)
    return np.frombuffer(stream.getvalue(), np.uint8)
