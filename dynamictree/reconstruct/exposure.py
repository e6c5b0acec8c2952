"""Equalize exposure and white balance between photos, which cameras set anew for each photo.

A splat has one colour per place; differences between photos become fog before the cameras. So each photo's channels are
divided by gains estimated from points that photos share (gain compensation, Brown and Lowe 2007).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import uniform_filter

from dynamictree.reconstruct.views import SparseModel, View

_SAME, _MOST = np.log(1.03), np.log(2.5)
"""Logarithms of gains: photos within the first are left unchanged; gains are clipped to the second."""


def equalise_exposure(model: SparseModel) -> SparseModel:
    """Return the model with photos of equal exposure and white balance; unchanged if they differ by less than 3 %."""
    log_gain = log_gains(model)
    if np.abs(log_gain).max(initial=0) < _SAME:
        return model
    images = (np.rint(view.image * np.exp(-gain)) for view, gain in zip(model.views, log_gain, strict=True))
    pairs = zip(model.views, images, strict=True)
    return replace(model, views=tuple(replace(one, image=np.minimum(own, 255).astype(np.uint8)) for one, own in pairs))


def log_gains(model: SparseModel) -> Float64[np.ndarray, "V 3"]:
    """Estimate each photo's log gain per channel by alternating weighted means; the mean over photos is 0."""
    color = np.zeros((len(model.seen), 3))
    for row, view in enumerate(model.views):
        mine = model.seen[:, 0] == row
        color[mine] = _colors_at(view, model.points[model.seen[mine, 1]])
    result = np.zeros((len(model.views), 3))
    for channel in range(3):
        result[:, channel] = _log_gains_of(model, color[:, channel])
    return np.clip(result, -_MOST, _MOST)


def _log_gains_of(model: SparseModel, color: Float64[np.ndarray, " M"]) -> Float64[np.ndarray, " V"]:
    fewest = 30  # well exposed points that a photo needs to be changed
    outlier = 0.3  # log gain; residuals above it (moving shadows, gloss, wrong matches) count no more than this
    rounds = 200  # photos of a walk share points with their neighbours only, so convergence is slow
    dark, bright = 12, 243  # [0 to 255]; values outside may be clipped
    usable = (color >= dark) & (color <= bright)
    view, point = model.seen[usable].T
    value = np.log(color[usable])
    number = len(model.views), len(model.points)
    gain, weight = np.zeros(number[0]), np.ones(len(value))
    for _ in range(rounds):
        own = _mean(value - gain[view], point, weight, number[1])
        gain = _mean(value - own[point], view, weight, number[0])
        weight = 1 / np.maximum(1, np.abs(value - own[point] - gain[view]) / outlier)
    judged = np.bincount(view, minlength=number[0]) >= fewest
    return np.zeros(number[0]) if not judged.any() else np.where(judged, gain - gain[judged].mean(), 0)


def _mean(
    values: Float64[np.ndarray, " M"], group: np.ndarray, weight: Float64[np.ndarray, " M"], number: int
) -> Float64[np.ndarray, " N"]:
    total = np.bincount(group, weight * values, number)
    result: Float64[np.ndarray, " N"] = total / np.maximum(np.bincount(group, weight, number), 1e-12)
    return result


def _colors_at(view: View, points: Float64[np.ndarray, "P 3"]) -> Float64[np.ndarray, "P 3"]:
    """Average the colour in a small window around each point; 0 for points outside the picture."""
    window_px = 3
    at, inside = view.pixels_of(points)
    smooth = uniform_filter(view.image.astype(np.float32), size=(window_px, window_px, 1))
    return np.where(inside[:, None], smooth[at], 0).astype(np.float64)
