"""Render Gaussian clouds with gsplat (Ye et al. 2024), if it is installed and there is a CUDA device."""

from functools import cache
from importlib.util import find_spec

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize_kernel import NEAR_M, PIXEL_PX2
from dynamictree.render.camera import Camera


@cache
def has_gsplat() -> bool:
    """Whether gsplat and a CUDA device are available; does not import torch without gsplat."""
    if find_spec("gsplat") is None:
        return False
    import torch

    return torch.cuda.is_available()


def world_to_camera_matrix(camera: Camera) -> Float64[np.ndarray, "4 4"]:
    """Return the camera's pose as gsplat's 4 × 4 matrix."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = camera.world_to_camera, -camera.world_to_camera @ camera.position_m
    return matrix


def render_with_gsplat(
    cloud: GaussianCloud, camera: Camera, *, width: int, height: int
) -> tuple[Float32[np.ndarray, "H W 3"], Float32[np.ndarray, "H W"], Float32[np.ndarray, "H W"]]:
    """Render a cloud; return colour times alpha, alpha, and mean depth [m]."""
    import gsplat
    import torch

    def on_device(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, np.float32)).cuda()

    with torch.no_grad():
        seen, alpha, _ = gsplat.rasterization(
            means=on_device(cloud.means),
            quats=on_device(cloud.quaternions),
            scales=on_device(cloud.scales),
            opacities=on_device(cloud.opacity),
            colors=on_device(cloud.sh),
            viewmats=on_device(world_to_camera_matrix(camera))[None],
            Ks=on_device(camera.intrinsics_px(width, height))[None],
            width=width,
            height=height,
            near_plane=float(NEAR_M),
            eps2d=PIXEL_PX2,
            sh_degree=cloud.sh_degree,
            render_mode="RGB+ED",
            rasterize_mode="antialiased",
        )
    picture = seen[0].cpu().numpy()
    return np.ascontiguousarray(picture[..., :3]), alpha[0, ..., 0].cpu().numpy(), np.ascontiguousarray(picture[..., 3])
