"""Visual hull: the part of space inside the masks of the photos (Laurentini 1994), refined from coarse cells."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from scipy.ndimage import binary_dilation, distance_transform_cdt, gaussian_filter

from dynamictree.errors import ReconstructionError
from dynamictree.reconstruct.views import View

_COVERED = 32  # least alpha inside a mask, of 255; low, since twigs narrower than a pixel cover a part of it
_FARTHEST_PX = 255  # largest distance from a mask that is stored
_REGION = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 2.0]])  # bounds in the upright frame
_LEAST_CONTRAST = 8.0  # standard deviation of grey, of 255; sky in JPEG has 1 to 3, leaves in front of it 20 and more


class _Mask(NamedTuple):
    """Photo with each pixel's taxicab distance from the mask [px]; 0 inside."""

    view: View
    away_px: UInt8[np.ndarray, "H W"]


def hull_points(
    views: Sequence[View], number: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "P 3"], Float32[np.ndarray, "P 3"]]:
    """Sample random points in the visual hull, with the photos' mean colours; none if no photo has a mask.

    A point is in the hull if half of the photos see it and seven in eight of these have it inside the mask, dilated by
    2 px. If enough points are also inside the masks without dilation, only those are returned.

    Raises:
        ReconstructionError: the masks have no common point in space.
    """
    masked = [view for view in views if view.alpha is not None]
    if not masked:
        return np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    points, colors = points_in_masks(masked, number, rng)
    if len(points) == 0:
        raise ReconstructionError(
            f"the masks of {len(masked)} photos agree on no place in space; a mask must be white where the plant is "
            "and black elsewhere, of the same size and turn as its photo; check the masks, or give the photos without "
            "them"
        )
    return points, colors


def points_in_masks(
    masked: list[View], number: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "P 3"], Float32[np.ndarray, "P 3"]]:
    """Like `hull_points`, for photos that all have masks; no points if the masks have no common one."""
    candidates = 8  # random positions per wanted point
    masks = [_mask(view) for view in masked]
    centres, half = _refine_cells(masks, number)
    if len(centres) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    chosen = centres[rng.integers(len(centres), size=candidates * number)]
    points = chosen + rng.uniform(-half, half, (len(chosen), 3))
    points = points[_enough_masks(masks, points)]
    exact = np.ones(len(points), np.bool_)
    for mask in masks:
        at, _, visible = _projected(mask.view, points)
        exact &= visible & (mask.away_px[at] == 0)
    if exact.sum() >= number:
        points = points[exact]
    return points, _mean_colors(masks, points)


def _mask(view: View) -> _Mask:
    assert view.alpha is not None
    outside = view.alpha < _COVERED
    if outside.all():
        return _Mask(view, np.full(outside.shape, _FARTHEST_PX, np.uint8))
    away_px = distance_transform_cdt(outside, metric="taxicab")
    return _Mask(view, np.minimum(away_px, _FARTHEST_PX).astype(np.uint8))


def _refine_cells(masks: list[_Mask], number: int) -> tuple[Float64[np.ndarray, "C 3"], float]:
    """Return centres and half side of the cells that may contain the subject, refined down to a pixel."""
    first_cell, finest_cell_px, most_cells = 1 / 8, 1.5, 50_000
    half = 0.5 * first_cell
    sides = [np.arange(low + half, high, first_cell) for low, high in _REGION.T]
    cells = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    while True:
        cells = cells[_enough_masks(masks, cells, half)]
        if len(cells) == 0 or len(cells) >= max(number, most_cells):
            return cells, half
        middle = cells.mean(axis=0)
        cameras = [(mask.view.camera, len(mask.away_px)) for mask in masks]
        per_px = [np.linalg.norm(camera.position_m - middle) / (camera.focal * height) for camera, height in cameras]
        if 2 * half <= finest_cell_px * np.median(per_px):
            return cells, half
        cells, half = (cells[:, None] + half * corners).reshape(-1, 3), 0.5 * half


def _enough_masks(masks: list[_Mask], centres: Float64[np.ndarray, "C 3"], half: float = 0.0) -> Bool[np.ndarray, " C"]:
    """Whether enough dilated masks are set somewhere in each cell's projection."""
    least_seen = 1 / 2  # share of the photos
    max_disagreeing = 1 / 8  # share of the photos that see a point; one bad mask must not cut a hole into the plant
    dilation_px = 2  # tolerance for camera errors of a pixel, which would lose stems one pixel wide
    seen, inside = np.zeros(len(centres), np.int32), np.zeros(len(centres), np.int32)
    for mask in masks:
        at, radius_px, visible = _projected(mask.view, centres, np.sqrt(3) * half)
        seen += visible
        inside += visible & (mask.away_px[at] <= np.minimum(dilation_px + np.sqrt(2) * radius_px, _FARTHEST_PX))
    agreed: Bool[np.ndarray, " C"] = (seen >= least_seen * len(masks)) & (seen - inside <= max_disagreeing * seen)
    return agreed


def _projected(
    view: View, centres: Float64[np.ndarray, "C 3"], reach: float = 0.0
) -> tuple[tuple[Int64[np.ndarray, " C"], Int64[np.ndarray, " C"]], Float64[np.ndarray, " C"], Bool[np.ndarray, " C"]]:
    """Project spheres of radius `reach`: row and column (clipped to the picture), radius [px] and visibility."""
    height, width = view.image.shape[:2]
    x, y, depth = view.camera.project(centres, width, height).T
    radius_px = np.minimum(reach * view.camera.focal * height / np.maximum(depth - reach, 1e-6), width + height)
    visible = (depth > reach) & (np.abs(x - width / 2) <= width / 2 + radius_px)
    visible &= np.abs(y - height / 2) <= height / 2 + radius_px
    row, column = (np.clip(np.where(visible, v, 0), 0, side - 1).astype(int) for v, side in ((y, height), (x, width)))
    return (row, column), radius_px, visible


def _mean_colors(masks: list[_Mask], points: Float64[np.ndarray, "P 3"]) -> Float32[np.ndarray, "P 3"]:
    """Average each point's colour over the photos with it inside their mask, or else over all that see it."""
    total, weight = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
    for mask in masks:
        at, _, visible = _projected(mask.view, points)
        share = visible * np.where(mask.away_px[at] == 0, 1, 1e-3).astype(np.float32)
        total += share[:, None] * (mask.view.image[at] / np.float32(255))
        weight += share
    colors: Float32[np.ndarray, "P 3"] = total / np.maximum(weight, 1e-6)[:, None]
    return colors


def texture_points(
    views: Sequence[View],
    number: int,
    rng: np.random.Generator,
    covers: Sequence[UInt8[np.ndarray, "H W"]] | None = None,
) -> tuple[Float64[np.ndarray, "P 3"], Float32[np.ndarray, "P 3"]]:
    """Sample up to `number` random points of the region where photos are textured, with their mean colours.

    `covers` are the shares of each pixel that are not sky.
    """
    low, high, radius = 0.02, 2.0, 1.0  # cylinder of the photos' region around the plant
    masks = [textured_mask(view.image) for view in views]
    if covers is not None:
        masks = [np.minimum(mask, cover) for mask, cover in zip(masks, covers, strict=True)]
    textured = [replace(view, alpha=mask) for view, mask in zip(views, masks, strict=True)]
    points, colors = points_in_masks(textured, 4 * number, rng)
    height, away = points[:, 2], np.linalg.norm(points[:, :2], axis=1)
    rows = np.flatnonzero((away < radius) & (height > low) & (height < high))
    rows = rng.permutation(rows)[:number]
    return points[rows], colors[rows]


def textured_mask(image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W"]:
    """Return a mask, 255 where the local contrast is high, dilated by the window."""
    window_share = 1 / 320  # standard deviation of the window in which contrast is measured [longer side]
    window = max(1.0, window_share * max(image.shape))
    grey = image.astype(np.float32).mean(axis=2)
    variance = gaussian_filter(grey * grey, window) - gaussian_filter(grey, window) ** 2
    return np.where(binary_dilation(variance > _LEAST_CONTRAST**2, iterations=round(window)), 255, 0).astype(np.uint8)
