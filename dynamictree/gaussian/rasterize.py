"""Pictures of Gaussian clouds. Kerbl et al. 2023, with the antialiasing of Mip-Splatting (Yu et al. 2024).

On the CPU, or by gsplat where CUDA is.

A Gaussian is projected to an ellipse, the ellipses are sorted by depth and listed by tiles of 16 × 16 pixels, each tile
blends its list front to back. `render_slowly` is the readable twin: every Gaussian at every pixel, in double precision.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64, UInt8

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cuda import gsplat_is_there, render_with_gsplat
from dynamictree.gaussian.deform import Pose, posed
from dynamictree.gaussian.harmonics import harmonics
from dynamictree.gaussian.rasterize_kernel import (
    BLUR_PX2,
    MAX_ALPHA,
    MIN_ALPHA,
    NEAR_M,
    PIXEL_PX2,
    TILE,
    WIDEST,
    blend,
    list_tiles,
    project,
)
from dynamictree.parallel import in_bands
from dynamictree.render.camera import Camera
from dynamictree.rotation import quaternion_matrices

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
    cloud: GaussianCloud,
    camera: Camera,
    *,
    width: int,
    height: int,
    pose: Pose | None = None,
    antialias: bool = True,
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
    ellipses, bounds = projected(cloud, camera, width=width, height=height, pose=pose, antialias=antialias)
    order, starts = tile_lists(ellipses, bounds, width, height)
    picture = np.zeros((height, width, 5), np.float32)
    in_bands(blend, len(starts) - 1, ellipses, bounds, order, starts, picture)
    return _finished(picture)


def projected(
    cloud: GaussianCloud, camera: Camera, *, width: int, height: int, pose: Pose | None = None, antialias: bool = True
) -> tuple[Float32[np.ndarray, "G 10"], Int32[np.ndarray, "G 4"]]:
    """Ellipses in the picture (centre, conic, opacity, colour, depth), and left, right, top and bottom of each [px].

    Nothing is written where a Gaussian is not seen, so its bounds are empty.
    """
    now = pose or Pose(means=cloud.means, quaternions=cloud.quaternions, scales=cloud.scales)
    ellipses = np.zeros((cloud.num_gaussians, 10), np.float32)
    bounds = np.zeros((cloud.num_gaussians, 4), np.int32)
    in_bands(
        project,
        cloud.num_gaussians,
        np.ascontiguousarray(now.means),
        np.ascontiguousarray(now.quaternions),
        np.ascontiguousarray(now.scales),
        cloud.opacity,
        cloud.sh,
        cloud.quaternions,
        _view(camera, width, height),
        antialias,
        pose is not None,
        ellipses,
        bounds,
    )
    return ellipses, bounds


def tile_lists(
    ellipses: Float32[np.ndarray, "G 10"], bounds: Int32[np.ndarray, "G 4"], width: int, height: int
) -> tuple[Int32[np.ndarray, " listed"], Int64[np.ndarray, " tiles_and_one"]]:
    """Which Gaussians each tile shows, the nearest first; tile t lists order[starts[t]:starts[t + 1]]."""
    columns, rows = -(-width // TILE), -(-height // TILE)
    seen = np.flatnonzero(bounds[:, 1] > bounds[:, 0])
    nearest_first = seen[np.argsort(ellipses[seen, 9], kind="stable")]
    starts = np.zeros(columns * rows + 1, np.int64)
    list_tiles(nearest_first, bounds, columns, starts, np.empty(0, np.int32), False)
    starts = np.concatenate([[0], np.cumsum(starts[:-1])])
    order = np.empty(int(starts[-1]), np.int32)
    list_tiles(nearest_first, bounds, columns, starts[:-1].copy(), order, True)
    return order, starts


def render_slowly(
    cloud: GaussianCloud,
    camera: Camera,
    *,
    width: int,
    height: int,
    antialias: bool = True,
    min_alpha: float = MIN_ALPHA,
) -> SplatPicture:
    """The readable twin of `render_cloud`; with `min_alpha=0` nothing at all is left out."""
    in_camera = (cloud.means - camera.position_m) @ camera.world_to_camera.T  # [G, 3]
    intrinsics = camera.intrinsics_px(width, height)
    focal = intrinsics[0, 0]
    x, y, z = in_camera.T
    safe_z = np.maximum(z, NEAR_M)
    limits = WIDEST * 0.5 * np.array([width, height]) / focal
    slope_x, slope_y = (np.clip(v / safe_z, -limit, limit) for v, limit in zip((x, y), limits, strict=True))
    zero = np.zeros_like(z)
    jacobian = np.array([[1 + zero, zero, -slope_x], [zero, 1 + zero, -slope_y]]).transpose(2, 0, 1)
    jacobian *= focal / safe_z[:, None, None]  # [G, 2, 3]
    axes = camera.world_to_camera @ quaternion_matrices(cloud.quaternions.astype(np.float64)) * cloud.scales[:, None, :]
    half = jacobian @ axes  # [G, 2, 3]
    sharp = half @ half.transpose(0, 2, 1)
    blurred = sharp + (PIXEL_PX2 if antialias else BLUR_PX2) * np.eye(2)
    opacity = cloud.opacity.astype(np.float64)
    if antialias:
        opacity = opacity * np.sqrt(np.maximum(np.linalg.det(sharp), 0) / np.linalg.det(blurred))
    conics = np.linalg.inv(blurred)
    centres = in_camera @ intrinsics.T / safe_z[:, None]
    colors = colors_seen(cloud, camera)
    pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)  # [H, W, 2]
    picture = np.zeros((height, width, 5))
    picture[..., 4] = 1
    for g in np.argsort(z, kind="stable"):
        if z[g] < NEAR_M:
            continue
        away = pixels - centres[g, :2]
        alpha = opacity[g] * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", away, conics[g], away))
        alpha = np.minimum(np.where(alpha < min_alpha, 0, alpha), MAX_ALPHA)
        contribution = alpha * picture[..., 4]
        picture[..., :3] += contribution[..., None] * colors[g]
        picture[..., 3] += contribution * z[g]
        picture[..., 4] -= contribution
    return _finished(picture.astype(np.float32))


def colors_seen(cloud: GaussianCloud, camera: Camera) -> Float64[np.ndarray, "G 3"]:
    """Colour of each Gaussian from where the camera stands; not below black."""
    directions = cloud.means - camera.position_m
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    colors: Float64[np.ndarray, "G 3"] = np.einsum("gh,ghc->gc", harmonics(directions, cloud.sh_degree), cloud.sh) + 0.5
    result: Float64[np.ndarray, "G 3"] = np.maximum(colors, 0)
    return result


def check_size(width: int, height: int) -> None:
    """Refuse pictures without pixels or of too many.

    Raises:
        InputError: the size is out of bounds.
    """
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise InputError(f"the picture is {width} × {height}; from 1 × 1 to {MAX_PIXELS:,} pixels are allowed")


def _view(camera: Camera, width: int, height: int) -> Float32[np.ndarray, " 19"]:
    """The camera as the kernel takes it: rotation by rows, position, focal length, centre, size."""
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
