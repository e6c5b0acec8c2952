"""Depth maps of all views: coarse ones of whole pictures, fine ones of the subject."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32
from PIL import Image
from scipy.spatial import cKDTree

from dynamictree.files import replacing
from dynamictree.reconstruct.fusion import Box
from dynamictree.reconstruct.sky import Foreground
from dynamictree.reconstruct.stereo import (
    Hypotheses,
    StereoView,
    agreed_depths,
    match_view,
    neighbours_of,
)
from dynamictree.reconstruct.views import SparseModel, View, nearest_pixels

COARSE_SIDE_PX, FINE_SIDE_PX = 256, 720
_COARSE_ITERATIONS, _FINE_ITERATIONS = 3, 2


@dataclass(frozen=True, kw_only=True)
class DepthMaps:
    """Depths that neighbouring views confirm."""

    views: list[StereoView]
    depths: list[Float32[np.ndarray, "H W"]]  # 0 where unknown [units of the cameras]


@dataclass(frozen=True, kw_only=True)
class Matches:
    """Planes that stereo proposes before views confirm each other: where a finer match starts."""

    neighbours: list[list[int]]
    planes: list[Hypotheses]


def coarse_depths(model: SparseModel, on_view: Callable[[int, int], None]) -> tuple[DepthMaps, Matches]:
    """Match whole pictures, starting from the depth of the nearest point of structure from motion."""
    views = [stereo_view(view, COARSE_SIDE_PX) for view in model.views]
    positions = np.array([view.position for view in views])
    masks = [_mask(view, stereo.grey.shape) for view, stereo in zip(model.views, views, strict=True)]
    neighbours = neighbours_of(positions, model.points, model.seen)
    planes = []
    for number, view in enumerate(views):
        on_view(number, len(views))
        guess = _sparse_guess(model, view, number)
        together = [views[index] for index in (number, *neighbours[number])]
        planes.append(_matched(model, together, number, guess, mask=masks[number]))
    return _confirmed(views, neighbours, planes, masks), Matches(neighbours=neighbours, planes=planes)


def fine_depths(model: SparseModel, coarse: Matches, box: Box, on_view: Callable[[int, int], None]) -> DepthMaps:
    """Match again at a higher resolution, only where a ray meets the box."""
    views = [stereo_view(view, FINE_SIDE_PX) for view in model.views]
    masks = [_mask(view, stereo.grey.shape) for view, stereo in zip(model.views, views, strict=True)]
    planes = []
    for number, view in enumerate(views):
        on_view(number, len(views))
        guess = _enlarged(coarse.planes[number], view.grey.shape)
        mask = rays_through(view, box) & masks[number]
        together = [views[index] for index in (number, *coarse.neighbours[number])]
        planes.append(_matched(model, together, number, guess, mask=mask, num_iterations=_FINE_ITERATIONS))
    return _confirmed(views, coarse.neighbours, planes, masks)


def save_depths(coarse: DepthMaps, fine: DepthMaps | None, box: Box, path: Path) -> None:
    """Write depth maps, and the box that the fine ones are limited to."""
    fine_maps = [] if fine is None else fine.depths
    arrays = {
        f"{name}_{row}": m for name, maps in (("c", coarse.depths), ("f", fine_maps)) for row, m in enumerate(maps)
    }
    arrays["box"] = np.stack([box.low, box.high])
    with replacing(path) as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def load_depths(model: SparseModel, path: Path) -> tuple[DepthMaps, DepthMaps | None, Box]:
    """Read what `save_depths` wrote for the same views."""
    with np.load(path, allow_pickle=False) as arrays:
        low, high = arrays["box"]
        coarse, fine = (
            [arrays[f"{name}_{row}"] for row in range(len(model.views)) if f"{name}_{row}" in arrays] for name in "cf"
        )
    coarse_maps = DepthMaps(views=[stereo_view(view, COARSE_SIDE_PX) for view in model.views], depths=coarse)
    fine_maps = DepthMaps(views=[stereo_view(view, FINE_SIDE_PX) for view in model.views], depths=fine)
    return coarse_maps, fine_maps if fine else None, Box(low=low, high=high)


def outside_sky(maps: DepthMaps, sky: Sequence[Foreground]) -> DepthMaps:
    """The same maps, unknown where more than half of a pixel is sky."""
    mostly = 0.5
    depths = []
    for depth, view in zip(maps.depths, sky, strict=True):
        cover = Image.fromarray(view.cover).resize(depth.shape[::-1], Image.Resampling.BOX)
        depths.append(np.where(np.asarray(cover) > mostly, depth, 0).astype(np.float32))
    return DepthMaps(views=maps.views, depths=depths)


def stereo_view(view: View, side_px: int) -> StereoView:
    """A grey picture of at most that many pixels a side."""
    picture = Image.fromarray(view.image).convert("L")
    picture.thumbnail((side_px, side_px), Image.Resampling.LANCZOS)
    grey = np.asarray(picture, np.float32) / 255
    rotation, position = view.camera.world_to_camera, view.camera.position_m
    to_pixel = view.camera.intrinsics_px(grey.shape[1], grey.shape[0]) @ rotation
    return StereoView(
        grey=np.ascontiguousarray(grey),
        to_pixel=np.concatenate([to_pixel, -(to_pixel @ position)[:, None]], axis=1),
        to_ray=np.ascontiguousarray(np.linalg.inv(to_pixel)),
        position=np.ascontiguousarray(position),
    )


def rays_through(view: StereoView, box: Box) -> Bool[np.ndarray, "H W"]:
    """Whether each pixel's ray meets the box (slabs)."""
    height, width = view.grey.shape
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([column, row, np.ones_like(row)], axis=2) @ view.to_ray.T  # [H, W, 3]
    rays = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    first, second = (box.low - view.position) / rays, (box.high - view.position) / rays
    enter, leave = np.minimum(first, second).max(axis=2), np.maximum(first, second).min(axis=2)
    meets: Bool[np.ndarray, "H W"] = leave > np.maximum(enter, 0)
    return meets


def _matched(
    model: SparseModel,
    views: list[StereoView],
    number: int,
    guess: Hypotheses,
    *,
    mask: Bool[np.ndarray, "H W"],
    num_iterations: int = _COARSE_ITERATIONS,
) -> Hypotheses:
    min_points = 12  # that a view must see to be matched
    depth_percentiles, depth_slack = (1.0, 99.0), 1.25  # of a view's points
    points = model.points[model.seen[model.seen[:, 0] == number, 1]]
    if len(points) < min_points or len(views) == 1:
        return guess
    depth = points @ views[0].to_pixel[2, :3] + views[0].to_pixel[2, 3]
    low, high = np.percentile(depth, depth_percentiles)
    bounds = float(low) / depth_slack, float(high) * depth_slack
    return match_view(views, guess, bounds, mask, num_iterations=num_iterations, seed=number)


def _sparse_guess(model: SparseModel, view: StereoView, number: int) -> Hypotheses:
    height, width = view.grey.shape
    points = model.points[model.seen[model.seen[:, 0] == number, 1]]
    in_picture = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ view.to_pixel.T
    in_picture = in_picture[in_picture[:, 2] > 0]
    inverse = np.ones((height, width), np.float32)
    if len(in_picture):
        column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        pixels = np.stack([column.ravel(), row.ravel()], axis=1)
        nearest = cKDTree(in_picture[:, :2] / in_picture[:, 2:]).query(pixels)[1]
        inverse = (1 / in_picture[nearest, 2]).reshape(height, width).astype(np.float32)
    return Hypotheses(inverse, np.zeros((height, width, 2), np.float32), np.full((height, width), 3, np.float32))


def _enlarged(planes: Hypotheses, shape: tuple[int, ...]) -> Hypotheses:
    height, width = shape
    slope = nearest_pixels(planes.slope, height, width) * np.float32(planes.inverse.shape[1] / width)
    return Hypotheses(nearest_pixels(planes.inverse, height, width), slope, np.full(shape, 3, np.float32))


def _mask(view: View, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """The view's mask at another size; everything where it has none."""
    if view.alpha is None:
        return np.ones(shape, np.bool_)
    smaller = Image.fromarray(view.alpha).resize((shape[1], shape[0]), Image.Resampling.BOX)
    mask: Bool[np.ndarray, "h w"] = np.asarray(smaller) >= 128
    return mask


def _confirmed(
    views: list[StereoView],
    neighbours: list[list[int]],
    planes: list[Hypotheses],
    masks: list[Bool[np.ndarray, "h w"]],
) -> DepthMaps:
    least = 2 if len(views) > 6 else 1
    agreed = agreed_depths(views, planes, neighbours, min_agreeing=least)
    depths = [np.where(mask, depth, 0).astype(np.float32) for mask, depth in zip(masks, agreed, strict=True)]
    return DepthMaps(views=views, depths=depths)
