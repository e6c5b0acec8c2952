"""Start points in thin crowns, where neither structure from motion nor stereo has any.

A crown of leaves before the sky or a lawn shows texture from all around; sky, walls and other plain things do not. So
the visual hull of the textured parts of the photos holds the crown, and free space before textured ground besides:
what is not needed there fades within a few hundred steps.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from scipy.ndimage import binary_dilation, gaussian_filter

from dynamictree.reconstruct.views import View
from dynamictree.reconstruct.visual_hull import points_in_masks

_WINDOW_SHARE = 1 / 320  # of the longer side, standard deviation of the window in which contrast is measured
_LEAST_CONTRAST = 8.0  # of 255: sky in JPEG has 1 to 3, leaves before it 20 and more
_LOW, _HIGH, _RADIUS = 0.02, 2.0, 1.0  # of the stage's region, in whose middle the plant stands


def texture_points(
    views: Sequence[View],
    number: int,
    rng: np.random.Generator,
    covers: Sequence[Float32[np.ndarray, "H W"]] | None = None,
) -> tuple[Float64[np.ndarray, "P 3"], Float32[np.ndarray, "P 3"]]:
    """Up to `number` random points of the region that photos show as textured, with the photos' mean colours.

    `covers` are the shares of pixels that are not sky.
    """
    textured = [replace(view, alpha=textured_mask(view.image)) for view in views]
    if covers is not None:
        pairs = zip(textured, covers, strict=True)
        textured = [replace(view, alpha=(view.alpha * cover).astype(np.uint8)) for view, cover in pairs]
    points, colors = points_in_masks(textured, 4 * number, rng)
    height, away = points[:, 2], np.linalg.norm(points[:, :2], axis=1)
    rows = np.flatnonzero((away < _RADIUS) & (height > _LOW) & (height < _HIGH))
    rows = rng.permutation(rows)[:number]
    return points[rows], colors[rows]


def textured_mask(image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W"]:
    """255 where the brightness varies around a pixel, dilated by the window."""
    window = max(1.0, _WINDOW_SHARE * max(image.shape))
    grey = image.astype(np.float32).mean(axis=2)
    variance = gaussian_filter(grey * grey, window) - gaussian_filter(grey, window) ** 2
    return np.where(binary_dilation(variance > _LEAST_CONTRAST**2, iterations=round(window)), 255, 0).astype(np.uint8)
