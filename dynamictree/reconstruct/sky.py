"""Detect sky in photos and remove it; it has no position, so it would become fog between the leaves.

Plain sky is a large bright piece without texture at the photo's edge, above the horizon. Other pixels above the horizon
get an alpha by matting: the position of their colour between that of plain sky nearby and that of the foreground.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from PIL import Image
from scipy.ndimage import binary_dilation, gaussian_filter, label

from dynamictree.reconstruct.views import View, resized
from dynamictree.reconstruct.visual_hull import textured_mask

Mask = Bool[np.ndarray, "H W"]
Picture = Float32[np.ndarray, "H W 3"]

_LEAST_SKY = 0.04  # share of a photo, in half of those that look up; windows and lamps have less
_HORIZON = -0.1  # sine of the elevation; below 0, since hedges are low and the vertical has errors
_LEAST_CONTRAST = 0.15  # least distance between the colours of sky and foreground
_REACH = 1 / 16  # standard deviation of the averaging window [longer side]


@dataclass(frozen=True, kw_only=True)
class Foreground:
    """Photo without its sky, in bytes, since floats of 60 photos of 12 megapixels take gigabytes."""

    image: UInt8[np.ndarray, "H W 3"]  # colour of the foreground
    alpha: UInt8[np.ndarray, "H W"]  # share of the foreground, 255 for a whole pixel


def without_sky(views: Sequence[View], depths: Sequence[Float32[np.ndarray, "_ _"]]) -> list[Foreground] | None:
    """Remove the sky from photos; return None if fewer than half of the photos that look up show sky.

    Args:
        views: photos in a frame with +Z up.
        depths: depth map of each view, of any size, 0 where unknown.
    """
    plain = [_plain_sky(view, _elevation(view), depth) for view, depth in zip(views, depths, strict=True)]
    num_looking_up = sum(float(_elevation(view).max()) > 0 for view in views)
    num_sky = sum(float(sky.mean()) >= _LEAST_SKY for sky in plain)
    if num_sky < max(1, 0.5 * num_looking_up):
        return None
    return [_foreground(view, _elevation(view), sky) for view, sky in zip(views, plain, strict=True)]


def _elevation(view: View) -> Float32[np.ndarray, "H W"]:
    """Compute the sine of each pixel's elevation above the horizon."""
    height, width = view.image.shape[:2]
    to_world = view.camera.world_to_camera.T @ np.linalg.inv(view.camera.intrinsics_px(width, height))
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([column, row, np.ones_like(row)], axis=2) @ to_world.T
    return np.asarray(rays[..., 2] / np.linalg.norm(rays, axis=2), np.float32)


def _plain_sky(view: View, elevation: Float32[np.ndarray, "H W"], depth: Float32[np.ndarray, "h w"]) -> Mask:
    """Find large bright pieces without texture and depth at the photo's edge."""
    brighter = 1.1  # brightness over the median of the rest
    least_blue = 0.9  # blue over red and green, since sky is blue, grey or white
    least_piece = 0.01  # share of a photo
    measured = np.asarray(Image.fromarray(depth > 0).resize(elevation.shape[::-1], Image.Resampling.NEAREST))
    piece, number = label((elevation > _HORIZON) & (textured_mask(view.image) == 0) & ~measured)
    if number == 0:
        return np.zeros(elevation.shape, np.bool_)
    size = np.bincount(piece.ravel(), minlength=number + 1)
    total = [np.bincount(piece.ravel(), view.image[..., channel].ravel(), number + 1) for channel in range(3)]
    color = np.stack(total, axis=1) / np.maximum(size, 1)[:, None]
    sky = np.isin(np.arange(number + 1), np.concatenate([piece[0], piece[:, 0], piece[:, -1]]))
    sky &= (size >= least_piece * piece.size) & (color[:, 2] >= least_blue * color[:, :2].max(axis=1))
    sky &= np.bincount(piece.ravel(), elevation.ravel(), number + 1) > 0
    sky[0] = False
    rest = ~sky[piece]
    if rest.any():
        sky &= color.mean(axis=1) > brighter * np.median(view.image.mean(axis=2)[rest])
    return np.asarray(sky[piece])


def _foreground(view: View, elevation: Float32[np.ndarray, "H W"], sky: Mask) -> Foreground:
    rim = 4 / 320  # share of the longer side; sky this near to trees and roofs looks textured
    noise = 0.15  # alpha nearer to 0 or 1 than this is rounded
    unlike = 0.3  # distance of colours in [0, 1]³ from which a pixel is foreground
    if not sky.any():
        return Foreground(image=view.image, alpha=np.full(sky.shape, 255, np.uint8))
    photo = view.image.astype(np.float32) / 255
    sky_color = _mean_nearby(photo, sky)
    own_color = _mean_nearby(photo, ~sky & (np.linalg.norm(photo - sky_color, axis=2) > unlike))
    way = own_color - sky_color
    length2 = (way**2).sum(axis=2)
    place = ((photo - sky_color) * way).sum(axis=2) / np.maximum(length2, 1e-6)
    cover = np.clip((place - noise) / (1 - 2 * noise), 0, 1)
    lowest = elevation[binary_dilation(sky, iterations=max(4, round(rim * max(sky.shape))))].min()
    cover = np.where((elevation >= lowest) & (length2 > _LEAST_CONTRAST**2), cover, 1)
    cover = np.where(sky, 0, cover)
    share = np.where(cover < 1, np.clip(place, 0, 1), 1)[..., None]
    color = np.where(share > noise, (photo - (1 - share) * sky_color) / np.maximum(share, noise), own_color)
    image, alpha = (np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8) for values in (color, cover))
    return Foreground(image=image, alpha=alpha)


def _mean_nearby(photo: Picture, chosen: Mask) -> Picture:
    """Average the colour of the chosen pixels around each pixel; if none is near, of all of them."""
    far_weight = 1e-4  # weight of the mean over the whole photo
    coarser = 4  # [px] per pixel of the averaged pictures
    weight = chosen.astype(np.float32)
    height, width = chosen.shape
    size = max(1, width // coarser), max(1, height // coarser)
    sums = [resized(plane, size) for plane in (weight, *np.moveaxis(photo * weight[..., None], 2, 0))]
    near = [gaussian_filter(plane, _REACH * max(size)) + np.float32(far_weight * plane.mean()) for plane in sums]
    means = [plane / np.maximum(near[0], np.float32(1e-12)) for plane in near[1:]]
    return np.stack([resized(mean, (width, height), Image.Resampling.BILINEAR) for mean in means], axis=2)
