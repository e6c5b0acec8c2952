"""Which Gaussians make up a pixel of a picture."""

import numpy as np
from jaxtyping import Float32, Int64

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize import draw
from dynamictree.gaussian.rasterize_kernel import MAX_ALPHA, MIN_ALPHA
from dynamictree.render.camera import Camera


def weights_at(
    cloud: GaussianCloud, camera: Camera, pixels: Int64[np.ndarray, "P 2"], *, width: int, height: int
) -> Float32[np.ndarray, " G"]:
    """The largest share that each Gaussian has in one of the pixels, as `render_cloud` blends them.

    Args:
        cloud: in metres.
        camera: where from.
        pixels: column and row of each.
        width: of the picture [px].
        height: of the picture [px].
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
