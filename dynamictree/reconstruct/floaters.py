"""Floaters around a plant, which show once it stands before another background.

Some have the colour of what is behind them, so photos do not separate them; others hang in the air, faint.
"""

import numpy as np
from jaxtyping import Bool, Float32, Int64
from scipy.spatial import cKDTree

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.gaussian.rasterize import colors_seen, render_cloud
from dynamictree.reconstruct.photo_cameras import PhotoCamera

_SIDE_PX = 320
_MOST_VIEWS = 24
_LEAST_VIEWS = 3  # that see a Gaussian, to judge it by
_ALIKE = 0.12  # distance of colours in [0, 1]³ that counts as the background's own
_UNLIKE = 1.5  # times that: what differs so much from the background is the plant for sure
_SHARE = 0.7  # of the views in which it must be like what is behind it
_OPAQUE, _LEAST_OPAQUE = 0.5, 0.2  # what is no floater; of the plant's Gaussians
_TOGETHER, _STRAY = 8, 3.0  # the opaque ones that tell how dense they lie; times the usual distance: strays
_BESIDE = 0.5  # of that distance
_NEIGHBOURS = 8  # of the plant for sure, whose colours the plant has at a place


def background_floaters(
    cloud: GaussianCloud, own: Bool[np.ndarray, " G"], views: list[PhotoCamera]
) -> Bool[np.ndarray, " G"]:
    """Which of the chosen Gaussians look like what is behind them from nearly everywhere, and not like the plant there.

    What is left out changes none of the photos: where it is drawn, the background has its colour.
    """
    rows = np.flatnonzero(own)
    floaters = np.zeros(cloud.num_gaussians, np.bool_)
    if len(rows) <= _NEIGHBOURS or own.all():
        return floaters
    chosen = np.unique(np.linspace(0, len(views) - 1, _MOST_VIEWS).round().astype(int))
    off, count, alike = _against_background(cloud, rows, [views[row].reduced(_SIDE_PX) for row in chosen])
    judged = count >= _LEAST_VIEWS
    like_background = judged & (alike >= _SHARE * count)
    sure = judged & (off > _UNLIKE * _ALIKE)
    if sure.sum() <= _NEIGHBOURS:
        return floaters
    color = cloud.subset(rows).sh[:, 0]
    near = cKDTree(cloud.means[rows[sure]]).query(cloud.means[rows], k=_NEIGHBOURS)[1]
    apart = np.linalg.norm(color[sure][near] - color[:, None], axis=2).min(axis=1) * SH_0
    floaters[rows] = like_background & ~sure & (apart > np.minimum(off, _ALIKE))
    return floaters


def faint_floaters(cloud: GaussianCloud, own: Bool[np.ndarray, " G"]) -> Bool[np.ndarray, " G"]:
    """Which of the chosen Gaussians hang in the air around the plant: faint ones away from all opaque ones, and strays.

    Learning leaves them before a textured background that it shows not quite right. Where few are opaque, none is one.
    """
    rows = np.flatnonzero(own)
    floaters = np.zeros(cloud.num_gaussians, np.bool_)
    opaque = rows[cloud.opacity[rows] > _OPAQUE]
    if len(opaque) < max(_TOGETHER, _LEAST_OPAQUE * len(rows)):
        return floaters
    spacing = np.asarray(cKDTree(cloud.means[opaque]).query(cloud.means[opaque], k=_TOGETHER)[0])[:, -1]
    usual = float(np.median(spacing))
    body = opaque[spacing <= _STRAY * usual]
    floaters[rows] = cKDTree(cloud.means[body]).query(cloud.means[rows])[0] > _BESIDE * usual
    return floaters


def _against_background(
    cloud: GaussianCloud, rows: Int64[np.ndarray, " M"], views: list[PhotoCamera]
) -> tuple[Float32[np.ndarray, " M"], Int64[np.ndarray, " M"], Int64[np.ndarray, " M"]]:
    """Mean distance of each Gaussian's colour from the background behind it, how often it is seen, how often alike."""
    plant = cloud.subset(rows)
    others = np.ones(cloud.num_gaussians, np.bool_)
    others[rows] = False
    background = cloud.subset(others)
    total = np.zeros(len(rows))
    count, alike = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
    for view in views:
        width, height = view.width, view.height
        behind = render_cloud(background, view.camera, width=width, height=height)
        before = render_cloud(plant, view.camera, width=width, height=height)
        x, y, depth = view.camera.project(plant.means, width, height).T
        inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        column, row = (np.where(inside, at, 0).astype(int) for at in (x, y))
        front = np.minimum(before.depth, behind.depth)[row, column]
        seen = inside & (depth <= 1.02 * front) & (behind.alpha[row, column] > 0.5)
        color = behind.color[row, column] / np.maximum(behind.alpha[row, column], 1e-6)[:, None]
        off = np.linalg.norm(np.clip(colors_seen(plant, view.camera), 0, 1) - color, axis=1)
        total += np.where(seen, off, 0)
        count += seen
        alike += seen & (off < _ALIKE)
    return (total / np.maximum(count, 1)).astype(np.float32), count, alike
