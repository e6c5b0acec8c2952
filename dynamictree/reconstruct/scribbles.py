"""Find the Gaussians that are visible under strokes on photos."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float32, Int8, Int64
from skimage.draw import line

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize import draw
from dynamictree.gaussian.rasterize_kernel import MAX_ALPHA, MIN_ALPHA
from dynamictree.photo_requests import Scribble
from dynamictree.reconstruct.photo_cameras import PhotoCamera, camera_of_photo
from dynamictree.render.camera import Camera


def labels_of_strokes(
    cloud: GaussianCloud,
    views: list[PhotoCamera],
    scribbles: Sequence[Scribble],
    *,
    background: Bool[np.ndarray, " G"] | None = None,
    on_stroke: Callable[[int], None] = lambda done: None,
) -> Int8[np.ndarray, " G"]:
    """Label Gaussians by strokes: 1 under strokes of the plant, -1 under other strokes, 0 elsewhere.

    A Gaussian under both belongs to the stroke in whose pixels it has the larger weight. A stroke of the plant that is
    mostly outside `background` selects none of it, since strokes along a trunk often extend into the soil.

    Raises:
        InputError: a stroke names no photo with a camera, or no Gaussian lies under the strokes of the plant.
    """
    least_weight = 0.15  # weight in a pixel; Gaussians with less are not selected
    side_px = 480  # long side of the picture on which strokes are rasterized
    weights = {True: np.zeros(cloud.num_gaussians, np.float32), False: np.zeros(cloud.num_gaussians, np.float32)}
    for done, scribble in enumerate(scribbles):
        on_stroke(done)
        view = camera_of_photo(views, scribble.photo).reduced(side_px)
        pixels = _pixels(scribble, view.width, view.height)
        under = weights_at(cloud, view.camera, pixels, width=view.width, height=view.height)
        if scribble.plant and background is not None and under[background].sum() < 0.5 * under.sum():
            under = np.where(background, np.float32(0), under)
        weights[scribble.plant] = np.maximum(weights[scribble.plant], under)
    plant, other = weights[True], weights[False]
    result = np.zeros(cloud.num_gaussians, np.int8)
    result[(plant >= least_weight) & (plant >= other)] = 1
    result[(other >= least_weight) & (other > plant)] = -1
    if any(scribble.plant for scribble in scribbles) and not (result > 0).any():
        raise InputError("nothing is seen under the strokes of the plant; draw them where scene.ply shows it")
    return result


def _pixels(scribble: Scribble, width: int, height: int) -> Int64[np.ndarray, "P 2"]:
    """Return column and row of a stroke's pixels, without repetition; a long stroke is subsampled."""
    most_pixels = 1000  # number per stroke; each costs a pass over all Gaussians
    click_px = 1  # half width of a stroke of one point
    at = [(min(int(y * height), height - 1), min(int(x * width), width - 1)) for x, y in scribble.points]
    if len(at) == 1:
        (row, column), reach = at[0], np.arange(-click_px, click_px + 1)
        rows, columns = (one.ravel() for one in np.meshgrid(row + reach, column + reach))
    else:
        segments = [line(*first, *last) for first, last in pairwise(at)]  # type: ignore[no-untyped-call]
        rows, columns = (np.concatenate(one) for one in zip(*segments, strict=True))
    pixels: Int64[np.ndarray, "P 2"] = np.unique(np.stack([columns, rows], axis=1), axis=0).astype(np.int64)
    return pixels[:: -(-len(pixels) // most_pixels)]


def weights_at(
    cloud: GaussianCloud, camera: Camera, pixels: Int64[np.ndarray, "P 2"], *, width: int, height: int
) -> Float32[np.ndarray, " G"]:
    """Compute each Gaussian's largest blending weight in any of the pixels, as in `render_cloud`.

    Args:
        cloud: Gaussians [m].
        camera: camera of the picture.
        pixels: column and row of each pixel.
        width: width of the picture [px].
        height: height of the picture [px].
    """
    drawing = draw(cloud, camera, width=width, height=height)
    ellipses, bounds = drawing.ellipses, drawing.bounds
    largest = np.zeros(cloud.num_gaussians, np.float32)
    for column, row in pixels:
        left, right, top, bottom = bounds.T
        rows = np.flatnonzero((left <= column) & (column < right) & (top <= row) & (row < bottom))
        rows = rows[np.argsort(ellipses[rows, 9], kind="stable")]
        x, y, xx, xy, yy, opacity = ellipses[rows, :6].T
        x, y = column + np.float32(0.5) - x, row + np.float32(0.5) - y
        alpha = np.minimum(opacity * np.exp(-0.5 * (xx * x * x + 2 * xy * x * y + yy * y * y)), np.float32(MAX_ALPHA))
        alpha[alpha < MIN_ALPHA] = 0
        light = np.cumprod(np.concatenate([np.ones(1, np.float32), 1 - alpha[:-1]]))[: len(rows)]
        largest[rows] = np.maximum(largest[rows], alpha * light)
    return largest
