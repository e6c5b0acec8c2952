"""CLIP-I and CLIP-T, paper section 6: distances of frames from the tree at rest, and from the previous frame.

A distance is 1 - cosine of two feature vectors, averaged over frames.
"""

from collections.abc import Iterable, Iterator

import numpy as np
import torch
from jaxtyping import Complex64, Float32, UInt8
from PIL import Image
from torch import Tensor

from dynamictree.mesh import TriangleMesh
from dynamictree.render import Camera, Renderer, RenderSettings
from dynamictree.spectrum import NUM_FRAMES, iter_motion
from lab.evaluation.clip import ClipEmbedder

SIDE_PX = 224
BATCH = 16
LARGEST_ERROR = 5.0
"""Bound on |ln ratio|, which is infinite if one of the two motions stands still."""

Picture = UInt8[np.ndarray, "_ _ 3"]


def embed_pictures(embedder: ClipEmbedder, pictures: Iterable[Picture]) -> Float32[Tensor, "P D"]:
    """Return one unit vector per picture; pictures are consumed lazily in batches."""
    rows, waiting = [], []
    for picture in pictures:
        waiting.append(_pixels(picture))
        if len(waiting) == BATCH:
            rows.append(_unit(embedder, waiting))
            waiting = []
    if waiting:
        rows.append(_unit(embedder, waiting))
    return torch.cat(rows)


def frame_distances(embedder: ClipEmbedder, view: Picture, frames: Iterable[Picture]) -> tuple[float, float]:
    """Return the mean distance of frames to the input view, and to the previous frame."""
    (seen,) = embed_pictures(embedder, [view])
    rows = embed_pictures(embedder, frames)
    return float(1 - (rows @ seen).mean()), float(1 - (rows[1:] * rows[:-1]).sum(dim=1).mean())


def motion_distances(
    embedder: ClipEmbedder,
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    *,
    num_frames: int = NUM_FRAMES,
) -> tuple[float, float]:
    """Compute `frame_distances` of a mesh's motion; the input view is the tree at rest from the same camera."""
    renderer = Renderer(mesh, RenderSettings(width=SIDE_PX, height=SIDE_PX))
    camera = Camera.orbit(mesh.vertices, aspect=1.0)
    frames = _frames(renderer, camera, coefficients, num_frames)
    return frame_distances(embedder, renderer.picture(camera=camera), frames)


def distance_error(distances: tuple[float, float], truth: tuple[float, float]) -> float:
    """Return the larger |ln ratio| of the two distances to those of the true motion.

    A small distance alone is no quality: frames that stand still have distance 0.
    """
    pairs = zip(distances, truth, strict=True)
    return max(
        LARGEST_ERROR if min(pair) <= 0 else min(abs(float(np.log(pair[0] / pair[1]))), LARGEST_ERROR) for pair in pairs
    )


def _frames(
    renderer: Renderer, camera: Camera, coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int
) -> Iterator[Picture]:
    for displacement in iter_motion(coefficients, np.arange(num_frames) / num_frames):
        yield renderer.picture(displacement, camera=camera)


def _unit(embedder: ClipEmbedder, pixels: list[Float32[Tensor, "3 S S"]]) -> Float32[Tensor, "P D"]:
    with torch.no_grad():
        return torch.nn.functional.normalize(embedder.features(torch.stack(pixels)), dim=1)


def _pixels(picture: Picture) -> Float32[Tensor, "3 S S"]:
    """Return the picture's centre square at `SIDE_PX`, with values in [0, 1]."""
    height, width = picture.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = Image.fromarray(picture[top : top + side, left : left + side])
    if side != SIDE_PX:
        square = square.resize((SIDE_PX, SIDE_PX), Image.Resampling.BICUBIC)
    scaled = np.asarray(square, np.float32) / 255
    return torch.from_numpy(np.ascontiguousarray(scaled.transpose(2, 0, 1)))
