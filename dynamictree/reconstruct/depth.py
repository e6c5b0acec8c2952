"""Depth maps of all views by multi-view stereo."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from PIL import Image
from scipy.spatial import cKDTree

from dynamictree.files import atomic_file
from dynamictree.reconstruct.fusion import Box
from dynamictree.reconstruct.sky import Foreground
from dynamictree.reconstruct.stereo import Hypotheses, StereoView, agreed_depths, match_view, neighbours_of
from dynamictree.reconstruct.views import SparseModel, View, resized

SIDE_PX = 256


@dataclass(frozen=True, kw_only=True)
class DepthMaps:
    """Depth maps whose depths are confirmed by neighbouring views."""

    views: list[StereoView]
    depths: list[Float32[np.ndarray, "H W"]]  # [units of the cameras], 0 where unknown


def find_depths(model: SparseModel, on_view: Callable[[int, int], None]) -> DepthMaps:
    """Match each view with its neighbours, starting from the depth of the nearest point of structure from motion."""
    least_agreeing = 2 if len(model.views) > 6 else 1
    views = [stereo_view(view, SIDE_PX) for view in model.views]
    positions = np.array([view.position for view in views])
    masks = [
        np.ones(stereo.grey.shape, np.bool_) if view.alpha is None else _mostly(view.alpha, stereo.grey.shape)
        for view, stereo in zip(model.views, views, strict=True)
    ]
    neighbours = neighbours_of(positions, model.points, model.seen)
    planes = []
    for number, mask in enumerate(masks):
        on_view(number, len(views))
        together = [views[index] for index in (number, *neighbours[number])]
        planes.append(_matched(model, together, number, mask))
    agreed = agreed_depths(views, planes, neighbours, min_agreeing=least_agreeing)
    depths = [np.where(mask, depth, 0).astype(np.float32) for mask, depth in zip(masks, agreed, strict=True)]
    return DepthMaps(views=views, depths=depths)


def save_depths(maps: DepthMaps, subject: Box | None, path: Path) -> None:
    """Write depth maps, and the subject's box if there is one."""
    arrays = {f"depth_{row}": depth for row, depth in enumerate(maps.depths)}
    if subject is not None:
        arrays["subject"] = np.stack([subject.low, subject.high])
    with atomic_file(path) as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def load_depths(model: SparseModel, path: Path) -> tuple[DepthMaps, Box | None]:
    """Read the depth maps and the box that `save_depths` wrote for the same views."""
    with np.load(path, allow_pickle=False) as arrays:
        depths = [arrays[f"depth_{row}"] for row in range(len(model.views))]
        subject = Box(low=arrays["subject"][0], high=arrays["subject"][1]) if "subject" in arrays else None
    return DepthMaps(views=[stereo_view(view, SIDE_PX) for view in model.views], depths=depths), subject


def outside_sky(maps: DepthMaps, sky: Sequence[Foreground]) -> DepthMaps:
    """Return the maps with depth unknown where more than half of a pixel is sky."""
    depths = [
        np.where(_mostly(view.alpha, depth.shape), depth, 0).astype(np.float32)
        for depth, view in zip(maps.depths, sky, strict=True)
    ]
    return DepthMaps(views=maps.views, depths=depths)


def stereo_view(view: View, side_px: int) -> StereoView:
    """Return a view's grey picture, at most `side_px` wide and high, with its camera's matrices."""
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


def _matched(model: SparseModel, views: list[StereoView], number: int, mask: Bool[np.ndarray, "H W"]) -> Hypotheses:
    min_points = 12  # points that a view must see to be matched
    depth_percentiles, depth_slack = (1.0, 99.0), 1.25  # percentiles of a view's points, and factor beyond them
    guess = _sparse_guess(model, views[0], number)
    points = model.points[model.seen[model.seen[:, 0] == number, 1]]
    if len(points) < min_points or len(views) == 1:
        return guess
    low, high = np.percentile(views[0].pixels(points)[1], depth_percentiles)
    bounds = float(low) / depth_slack, float(high) * depth_slack
    return match_view(views, guess, bounds, mask, num_iterations=3, seed=number)


def _sparse_guess(model: SparseModel, view: StereoView, number: int) -> Hypotheses:
    height, width = view.grey.shape
    points = model.points[model.seen[model.seen[:, 0] == number, 1]]
    places, depth = view.pixels(points)
    ahead = depth > 0
    inverse = np.ones((height, width), np.float32)
    if ahead.any():
        row, column = np.indices((height, width)).reshape(2, -1) + 0.5
        nearest = cKDTree(places[ahead]).query(np.stack([column, row], axis=1))[1]
        inverse = (1 / depth[ahead][nearest]).reshape(height, width).astype(np.float32)
    return Hypotheses(inverse, np.zeros((height, width, 2), np.float32), np.full((height, width), 3, np.float32))


def _mostly(alpha: UInt8[np.ndarray, "H W"], shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """Resize a mask; true where more than half of a pixel is covered."""
    return resized(alpha.astype(np.float32), (shape[1], shape[0])) >= 127.5
