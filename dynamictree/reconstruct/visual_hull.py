"""Visual hull: the part of space that the masks of the photos agree on (Laurentini 1994), refined from coarse cells."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from scipy.ndimage import binary_dilation

from dynamictree.errors import ReconstructionError
from dynamictree.reconstruct.views import View
from dynamictree.render.camera import Camera

_COVERED = 32  # of 255, the alpha of what counts as masked: a twig narrower than a pixel covers part of it only
DILATION_PX = 2  # of the masks: a stem one pixel wide is lost to cameras that are off by a pixel
_MAX_DISAGREEING = 1 / 8  # of the photos that see a place: one bad mask must not cut a hole into the plant
_LEAST_SEEN = 1 / 2  # of the photos
_LOW, _HIGH = np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 2.0])  # of the stage's region
_FIRST_CELL, _FINEST_CELL_PX = 1 / 8, 1.5
_MAX_CELLS = 400_000
_CANDIDATES = 8  # random places per wanted point


class _MaskPyramid(NamedTuple):
    """A mask at halved resolutions, each pixel the maximum of four, all in one array."""

    camera: Camera
    width: int
    height: int
    exact: UInt8[np.ndarray, "H W"]
    values: Bool[np.ndarray, " pixels"]
    starts: Int64[np.ndarray, " L"]
    widths: Int64[np.ndarray, " L"]
    heights: Int64[np.ndarray, " L"]


def hull_points(
    views: Sequence[View], number: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "P 3"], Float32[np.ndarray, "P 3"]]:
    """Random points in the visual hull with the photos' mean colours; none where no photo has a mask.

    A point counts if seven in eight of the photos that see it, and at least half of all, have it inside the mask
    dilated by 2 px. Where enough points are inside the masks as they are, only those count.

    Raises:
        ReconstructionError: the masks agree on no place at all.
    """
    masked = [view for view in views if view.alpha is not None]
    if not masked:
        return np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    points, colors = points_in_masks(masked, number, rng)
    if len(points) == 0:
        raise _nothing_left(len(masked))
    return points, colors


def points_in_masks(
    masked: list[View], number: int, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "P 3"], Float32[np.ndarray, "P 3"]]:
    """As `hull_points`, of photos that all have masks; no points where the masks agree on no place."""
    pyramids = [_pyramid(view) for view in masked]
    centres, half = _refined(pyramids, number)
    if len(centres) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    chosen = centres[rng.integers(len(centres), size=_CANDIDATES * number)]
    points = chosen + rng.uniform(-half, half, (len(chosen), 3))
    points = points[_agreed(pyramids, points, 0.0)]
    exact = _inside_all(pyramids, points)
    if exact.sum() >= number:
        points = points[exact]
    return points, _mean_colors(masked, points)


def _refined(pyramids: list[_MaskPyramid], number: int) -> tuple[Float64[np.ndarray, "C 3"], float]:
    """Centres and half the side of the cells that may hold the subject, halved until they are a pixel wide."""
    sides = [np.arange(low + 0.5 * _FIRST_CELL, high, _FIRST_CELL) for low, high in zip(_LOW, _HIGH, strict=True)]
    cells, half = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3), 0.5 * _FIRST_CELL
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    while True:
        cells = cells[_agreed(pyramids, cells, half)]
        if len(cells) == 0:
            return cells, half
        fine = 2 * half * _pixels_per_unit(pyramids, cells) <= _FINEST_CELL_PX
        if fine or len(cells) >= max(number, _MAX_CELLS // 8):
            return cells, half
        cells, half = (cells[:, None] + half * corners).reshape(-1, 3), 0.5 * half


def _agreed(pyramids: list[_MaskPyramid], centres: Float64[np.ndarray, "C 3"], half: float) -> Bool[np.ndarray, " C"]:
    """Whether enough masks are set somewhere in each cell's projection."""
    seen, inside = np.zeros(len(centres), np.int32), np.zeros(len(centres), np.int32)
    for pyramid in pyramids:
        width, height = pyramid.width, pyramid.height
        x, y, depth = pyramid.camera.project(centres, width, height).T
        reach = np.sqrt(3) * half
        near = np.maximum(depth - reach, 1e-6)
        radius = np.minimum(reach * pyramid.camera.focal * height / near, width + height)
        visible = (depth > reach) & (x + radius >= 0) & (x - radius < width) & (y + radius >= 0) & (y - radius < height)
        x, y, radius = x[visible], y[visible], radius[visible]
        level = np.ceil(np.log2(np.maximum(2 * radius, 1))).astype(int)
        level = np.minimum(level, len(pyramid.starts) - 1)
        hit = np.zeros(len(x), np.bool_)
        for right, down in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            column = np.clip((x + right * radius).astype(int) >> level, 0, pyramid.widths[level] - 1)
            row = np.clip((y + down * radius).astype(int) >> level, 0, pyramid.heights[level] - 1)
            hit |= pyramid.values[pyramid.starts[level] + row * pyramid.widths[level] + column]
        seen += visible
        inside[visible] += hit
    agreed: Bool[np.ndarray, " C"] = (seen >= _LEAST_SEEN * len(pyramids)) & (seen - inside <= _MAX_DISAGREEING * seen)
    return agreed


def _pyramid(view: View) -> _MaskPyramid:
    assert view.alpha is not None
    height, width = view.alpha.shape
    levels: list[Bool[np.ndarray, "h w"]] = [binary_dilation(view.alpha >= _COVERED, iterations=DILATION_PX)]
    while max(levels[-1].shape) > 1:
        padded = np.pad(levels[-1], [(0, side % 2) for side in levels[-1].shape])
        quads = padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2)
        levels.append(np.asarray(quads.any(axis=(1, 3))))
    return _MaskPyramid(
        camera=view.camera,
        width=width,
        height=height,
        exact=view.alpha,
        values=np.concatenate([level.ravel() for level in levels]),
        starts=np.cumsum([0, *(level.size for level in levels[:-1])]),
        widths=np.array([level.shape[1] for level in levels]),
        heights=np.array([level.shape[0] for level in levels]),
    )


def _inside_all(pyramids: list[_MaskPyramid], points: Float64[np.ndarray, "P 3"]) -> Bool[np.ndarray, " P"]:
    inside = np.ones(len(points), np.bool_)
    for pyramid in pyramids:
        x, y, depth = pyramid.camera.project(points, pyramid.width, pyramid.height).T
        visible = (depth > 0) & (x >= 0) & (y >= 0) & (x < pyramid.width) & (y < pyramid.height)
        row, column = np.where(visible, y, 0).astype(int), np.where(visible, x, 0).astype(int)
        inside &= visible & (pyramid.exact[row, column] >= _COVERED)
    return inside


def _mean_colors(views: list[View], points: Float64[np.ndarray, "P 3"]) -> Float32[np.ndarray, "P 3"]:
    """Mean over the photos that have a point inside their mask; over all that see it where none has."""
    total, weight = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
    for view in views:
        assert view.alpha is not None
        height, width = view.image.shape[:2]
        x, y, depth = view.camera.project(points, width, height).T
        visible = (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        at = np.where(visible, y, 0).astype(int), np.where(visible, x, 0).astype(int)
        share = visible * np.where(view.alpha[at] >= _COVERED, 1, 1e-3).astype(np.float32)
        total += share[:, None] * (view.image[at] / np.float32(255))
        weight += share
    colors: Float32[np.ndarray, "P 3"] = total / np.maximum(weight, 1e-6)[:, None]
    return colors


def _pixels_per_unit(pyramids: list[_MaskPyramid], cells: Float64[np.ndarray, "C 3"]) -> float:
    middle = cells.mean(axis=0)
    return float(
        np.median(
            [
                pyramid.camera.focal
                * pyramid.height
                / max(float(np.linalg.norm(pyramid.camera.position_m - middle)), 1e-6)
                for pyramid in pyramids
            ]
        )
    )


def _nothing_left(number: int) -> ReconstructionError:
    return ReconstructionError(
        f"the masks of {number} photos agree on no place in space; a mask must be white where the plant is and black "
        "elsewhere, of the same size and turn as its photo; check the masks, or give the photos without them"
    )
