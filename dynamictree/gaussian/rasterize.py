"""Render Gaussian clouds: Kerbl et al. 2023, with the antialiasing of Mip-Splatting (Yu et al. 2024).

It runs on the CPU, or with gsplat on CUDA. Gaussians below a pixel are fainter, not wider, so splats that were trained
without antialiasing look thinner.

Gaussians are projected to ellipses, sorted by depth and listed per tile of 16 × 16 pixels; each tile blends its list
front to back.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32, Int64, UInt8

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cuda import has_gsplat, render_with_gsplat
from dynamictree.gaussian.deform import Pose, apply_pose
from dynamictree.gaussian.rasterize_kernel import MIN_ALPHA, TILE, WIDEST, blend, list_tiles, project
from dynamictree.parallel import in_bands
from dynamictree.render.camera import Camera

MAX_PIXELS = 16_777_216  # [px], 4096²


@dataclass(frozen=True, kw_only=True)
class SplatPicture:
    """Rendered picture of a cloud."""

    color: Float32[np.ndarray, "H W 3"]  # display space, times alpha
    alpha: Float32[np.ndarray, "H W"]
    depth: Float32[np.ndarray, "H W"]  # mean depth along the camera's axis [m]; infinite where nothing is visible

    def over(self, background: tuple[float, float, float] | Float32[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
        """Composite the picture over a colour, or over another picture, in [0, 1]."""
        behind = np.asarray(background, np.float32) * (1 - self.alpha[..., None])
        return np.asarray(np.rint(np.clip(self.color + behind, 0, 1) * 255), np.uint8)


def render_cloud(
    cloud: GaussianCloud, camera: Camera, *, width: int, height: int, pose: Pose | None = None
) -> SplatPicture:
    """Render a cloud, optionally in a pose; colours rotate with the Gaussians.

    Args:
        cloud: cloud at rest.
        camera: camera of the picture.
        width: width of the picture [px].
        height: height of the picture [px].
        pose: current pose of the Gaussians; at rest by default.

    Raises:
        InputError: the size is out of bounds.
    """
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise InputError(f"the picture is {width} × {height}; from 1 × 1 to {MAX_PIXELS:,} pixels are allowed")
    if has_gsplat():
        posed_cloud = cloud if pose is None else apply_pose(cloud, pose)
        color, alpha, depth = render_with_gsplat(posed_cloud, camera, width=width, height=height)
        far = np.where(alpha > MIN_ALPHA, depth, np.float32(np.inf)).astype(np.float32)
        return SplatPicture(color=color, alpha=alpha, depth=far)
    return render_on_cpu(cloud, camera, width=width, height=height, pose=pose)


def render_on_cpu(
    cloud: GaussianCloud, camera: Camera, *, width: int, height: int, pose: Pose | None = None
) -> SplatPicture:
    """Render like `render_cloud`, but always on the CPU."""
    return _finished(draw(cloud, camera, width=width, height=height, pose=pose).picture)


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """Rendered picture with intermediate results for the backward pass of `reconstruct.gradient`."""

    cloud: GaussianCloud
    view: Float32[np.ndarray, " 19"]
    ellipses: Float32[np.ndarray, "G 10"]  # centre, conic, opacity, colour, depth
    bounds: Int32[np.ndarray, "G 4"]  # left, right, top, bottom [px]; empty if not visible
    order: Int32[np.ndarray, " listed"]  # Gaussians of each tile, nearest first
    starts: Int64[np.ndarray, " tiles_and_one"]  # tile t lists order[starts[t]:starts[t + 1]]
    picture: Float32[np.ndarray, "H W 5"]  # colour and depth, both times alpha, and transmittance


def draw(cloud: GaussianCloud, camera: Camera, *, width: int, height: int, pose: Pose | None = None) -> Drawing:
    """Project the Gaussians, list them by tiles, and blend each tile, on the CPU; arguments as for `render_cloud`."""
    now = pose or Pose(means=cloud.means, quaternions=cloud.quaternions, scales=cloud.scales)
    ellipses = np.zeros((cloud.num_gaussians, 10), np.float32)
    bounds = np.zeros((cloud.num_gaussians, 4), np.int32)
    view = _view(camera, width, height)
    shapes = (np.ascontiguousarray(part) for part in (now.means, now.quaternions, now.scales))
    looks = cloud.opacity, cloud.sh, cloud.quaternions
    in_bands(project, len(bounds), *shapes, *looks, view, pose is not None, ellipses, bounds)
    order, starts = tile_lists(ellipses, bounds, width, height)
    picture = np.zeros((height, width, 5), np.float32)
    in_bands(blend, len(starts) - 1, ellipses, bounds, order, starts, picture)
    lists = {"ellipses": ellipses, "bounds": bounds, "order": order, "starts": starts}
    return Drawing(cloud=cloud, view=view, **lists, picture=picture)


def tile_lists(
    ellipses: Float32[np.ndarray, "G 10"], bounds: Int32[np.ndarray, "G 4"], width: int, height: int
) -> tuple[Int32[np.ndarray, " listed"], Int64[np.ndarray, " tiles_and_one"]]:
    """List the Gaussians of each tile, nearest first; tile t lists order[starts[t]:starts[t + 1]]."""
    columns, rows = -(-width // TILE), -(-height // TILE)
    seen = np.flatnonzero(bounds[:, 1] > bounds[:, 0])
    bits = ellipses[seen, 9].view(np.uint32).astype(np.uint64)  # bits of positive floats sort like the floats
    by_depth = np.sort(bits << 32 | seen.astype(np.uint64))  # four times as fast as a stable argsort
    nearest_first = (by_depth & 0xFFFF_FFFF).astype(np.int64)
    starts = np.zeros(columns * rows + 1, np.int64)
    list_tiles(nearest_first, bounds, columns, starts, np.empty(0, np.int32), False)
    starts = np.concatenate([[0], np.cumsum(starts[:-1])])
    order = np.empty(int(starts[-1]), np.int32)
    list_tiles(nearest_first, bounds, columns, starts[:-1].copy(), order, True)
    return order, starts


def _view(camera: Camera, width: int, height: int) -> Float32[np.ndarray, " 19"]:
    """Pack a camera for the kernels: rotation by rows, position, focal length, centre, size, widest slopes."""
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
    """Create the picture from blended colour, depth and transmittance."""
    alpha = 1 - picture[..., 4]
    seen = alpha > MIN_ALPHA
    depth = np.full(alpha.shape, np.inf, np.float32)
    depth[seen] = picture[seen, 3] / alpha[seen]
    return SplatPicture(color=np.ascontiguousarray(picture[..., :3]), alpha=alpha, depth=depth)
