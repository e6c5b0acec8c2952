"""Pictures of Gaussian clouds. Kerbl et al. 2023, with the antialiasing of Mip-Splatting (Yu et al. 2024).

On the CPU, or by gsplat where CUDA is.

A Gaussian is projected to an ellipse, the ellipses are sorted by depth and listed by tiles of 16 × 16 pixels, each tile
blends its list front to back.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32, Int64, UInt8

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cuda import gsplat_is_there, render_with_gsplat
from dynamictree.gaussian.deform import Pose, posed
from dynamictree.gaussian.rasterize_kernel import MIN_ALPHA, TILE, WIDEST, blend, list_tiles, project
from dynamictree.parallel import in_bands
from dynamictree.render.camera import Camera

MAX_PIXELS = 16_777_216  # 4096²


@dataclass(frozen=True, kw_only=True)
class SplatPicture:
    """What a camera sees of a cloud."""

    color: Float32[np.ndarray, "H W 3"]  # display space, times alpha
    alpha: Float32[np.ndarray, "H W"]
    depth: Float32[np.ndarray, "H W"]  # mean along the axis of what is seen [m]; infinite where nothing is

    def over(self, background: tuple[float, float, float] | Float32[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
        """The picture in front of a colour, or of another picture, in [0, 1]."""
        behind = np.asarray(background, np.float32) * (1 - self.alpha[..., None])
        whole: UInt8[np.ndarray, "H W 3"] = np.rint(np.clip(self.color + behind, 0, 1) * 255).astype(np.uint8)
        return whole


def render_cloud(
    cloud: GaussianCloud, camera: Camera, *, width: int, height: int, pose: Pose | None = None, antialias: bool = True
) -> SplatPicture:
    """Draw a cloud, or a pose of it, whose colours then turn with the Gaussians: the view direction is turned back.

    Args:
        cloud: at rest.
        camera: where from.
        width: of the picture [px].
        height: of the picture [px].
        pose: where the Gaussians are now; at rest by default.
        antialias: what is smaller than a pixel becomes fainter, not wider; splats trained without it look thinner.

    Raises:
        InputError: no picture has that size.
    """
    check_size(width, height)
    if gsplat_is_there():
        posed_cloud = cloud if pose is None else posed(cloud, pose)
        color, alpha, depth = render_with_gsplat(posed_cloud, camera, width=width, height=height, antialias=antialias)
        far = np.where(alpha > MIN_ALPHA, depth, np.float32(np.inf)).astype(np.float32)
        return SplatPicture(color=color, alpha=alpha, depth=far)
    return render_on_cpu(cloud, camera, width=width, height=height, pose=pose, antialias=antialias)


def render_on_cpu(
    cloud: GaussianCloud, camera: Camera, *, width: int, height: int, pose: Pose | None = None, antialias: bool = True
) -> SplatPicture:
    """`render_cloud` without CUDA, whatever is there."""
    return _finished(draw(cloud, camera, width=width, height=height, pose=pose, antialias=antialias).picture)


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """A rendered picture and the intermediate results, which the backward pass of `reconstruct.gradient` reads."""

    cloud: GaussianCloud
    view: Float32[np.ndarray, " 19"]
    antialias: bool
    ellipses: Float32[np.ndarray, "G 10"]  # centre, conic, opacity, colour, depth
    bounds: Int32[np.ndarray, "G 4"]  # left, right, top, bottom [px]; empty where not seen
    order: Int32[np.ndarray, " listed"]  # Gaussians of each tile, the nearest first
    starts: Int64[np.ndarray, " tiles_and_one"]  # tile t lists order[starts[t]:starts[t + 1]]
    picture: Float32[np.ndarray, "H W 5"]  # colour and depth, both times alpha, and what is left of the light


def draw(
    cloud: GaussianCloud, camera: Camera, *, width: int, height: int, pose: Pose | None = None, antialias: bool = True
) -> Drawing:
    """Project the Gaussians, list them by tiles, and blend each tile, on the CPU; arguments as of `render_cloud`."""
    now = pose or Pose(means=cloud.means, quaternions=cloud.quaternions, scales=cloud.scales)
    ellipses = np.zeros((cloud.num_gaussians, 10), np.float32)
    bounds = np.zeros((cloud.num_gaussians, 4), np.int32)
    view = _view(camera, width, height)
    shapes = (np.ascontiguousarray(part) for part in (now.means, now.quaternions, now.scales))
    looks = cloud.opacity, cloud.sh, cloud.quaternions
    in_bands(project, len(bounds), *shapes, *looks, view, antialias, pose is not None, ellipses, bounds)
    order, starts = tile_lists(ellipses, bounds, width, height)
    picture = np.zeros((height, width, 5), np.float32)
    in_bands(blend, len(starts) - 1, ellipses, bounds, order, starts, picture)
    lists = {"ellipses": ellipses, "bounds": bounds, "order": order, "starts": starts}
    return Drawing(cloud=cloud, view=view, antialias=antialias, **lists, picture=picture)


def tile_lists(
    ellipses: Float32[np.ndarray, "G 10"], bounds: Int32[np.ndarray, "G 4"], width: int, height: int
) -> tuple[Int32[np.ndarray, " listed"], Int64[np.ndarray, " tiles_and_one"]]:
    """Which Gaussians each tile shows, the nearest first; tile t lists order[starts[t]:starts[t + 1]]."""
    columns, rows = -(-width // TILE), -(-height // TILE)
    seen = np.flatnonzero(bounds[:, 1] > bounds[:, 0])
    bits = ellipses[seen, 9].view(np.uint32).astype(np.uint64)  # of positive floats: in their order
    by_depth = np.sort(bits << 32 | seen.astype(np.uint64))  # a quarter of the time of a stable argsort
    nearest_first = (by_depth & 0xFFFF_FFFF).astype(np.int64)
    starts = np.zeros(columns * rows + 1, np.int64)
    list_tiles(nearest_first, bounds, columns, starts, np.empty(0, np.int32), False)
    starts = np.concatenate([[0], np.cumsum(starts[:-1])])
    order = np.empty(int(starts[-1]), np.int32)
    list_tiles(nearest_first, bounds, columns, starts[:-1].copy(), order, True)
    return order, starts


def check_size(width: int, height: int) -> None:
    """Refuse pictures without pixels or of too many.

    Raises:
        InputError: the size is out of bounds.
    """
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise InputError(f"the picture is {width} × {height}; from 1 × 1 to {MAX_PIXELS:,} pixels are allowed")


def _view(camera: Camera, width: int, height: int) -> Float32[np.ndarray, " 19"]:
    """The camera as the kernels take it: rotation by rows, position, focal length, centre, size, widest slopes."""
    intrinsics = camera.intrinsics_px(width, height)
    return np.concatenate(
        [
            camera.world_to_camera.ravel(),
            camera.position_m,
            [intrinsics[0, 0], intrinsics[0, 2], intrinsics[1, 2], width, height],
            WIDEST * 0.5 * np.array([width, height]) / intrinsics[0, 0],
        ]
    ).astype(np.float32)


def _finished(picture: Float32[np.ndarray, "H W 5"]) -> SplatPicture:
    """From blended colour, depth and what is left of the light."""
    alpha = 1 - picture[..., 4]
    seen = alpha > MIN_ALPHA
    depth = np.full(alpha.shape, np.inf, np.float32)
    depth[seen] = picture[seen, 3] / alpha[seen]
    return SplatPicture(color=np.ascontiguousarray(picture[..., :3]), alpha=alpha, depth=depth)
