"""Colours for the points of a scan that has none: light from above, on the sides where the cloud ends."""

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Float64, UInt8


def shaded_colors(points: Float64[np.ndarray, "G 3"], *, spacing: float) -> UInt8[np.ndarray, "G 3"]:
    """A grey per point, sRGB: facing the sun it is bright; below, behind and inside others it is dark.

    +Z is up; `spacing` is the usual distance of neighbours, in the points' unit.
    """
    grey = (150, 162, 128)  # sRGB of a point in full light
    cells = 160  # along the cloud's longest side
    most_cells = 6_000_000  # of the grid
    least_spacings = 2.0  # wide is a cell: the surface then is closed
    blur = 1.0  # cells
    sun = np.array([-0.45, -0.55, 0.70])  # from where the previews have it
    darkest = 0.42
    deep = 12.0  # cells of points above, that halve the light
    low = points.min(axis=0)
    extent = np.ptp(points, axis=0)
    size = max(float(extent.max()) / cells, least_spacings * spacing)
    size = max(size, float((np.prod(np.maximum(extent, 1e-12)) / most_cells) ** (1 / 3)))
    place = np.floor((points - low) / size).astype(np.int64) + 2  # two empty cells at every side
    shape = tuple(int(side) for side in place.max(axis=0) + 3)
    key = np.ravel_multi_index(tuple(place.T), shape)
    filled = np.bincount(key, minlength=int(np.prod(shape))).reshape(shape) > 0
    density = scipy.ndimage.gaussian_filter(filled.astype(np.float32), blur)
    outward = -np.stack([side.ravel()[key] for side in np.gradient(density)], axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)
    facing = 0.5 + 0.5 * outward @ (sun / np.linalg.norm(sun))
    above = np.cumsum(filled[:, :, ::-1], axis=2, dtype=np.int32)[:, :, ::-1].ravel()[key] - 1
    light = (darkest + (1 - darkest) * facing) * (0.75 + 0.25 * 0.5 ** (above / deep))
    colors: UInt8[np.ndarray, "G 3"] = np.round(light[:, None] * grey).clip(0, 255).astype(np.uint8)
    return colors
