"""Time per frame to render 100,000 Gaussians at 512² on the CPU [ms]. The paper: 2.65 ms on a GPU."""

import numpy as np

from benchmarks._machine import machine, time_calls
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize import render_cloud
from dynamictree.render.camera import Camera

NUM_GAUSSIANS = 100_000
TARGET_MS = 250.0


def gaussian_tree(num_gaussians: int) -> GaussianCloud:
    """Return a tree of Gaussians with SH degree 3: leaves in a ball of 2 m on a trunk."""
    rng = np.random.default_rng(0)
    leaves = rng.normal(size=(num_gaussians, 3))
    leaves *= 2 * rng.random((num_gaussians, 1)) ** (1 / 3) / np.linalg.norm(leaves, axis=1, keepdims=True)
    trunk = rng.random(num_gaussians) < 0.1
    angle = rng.random(num_gaussians) * 2 * np.pi
    bark = np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), rng.random(num_gaussians) * -3 - 1], axis=1)
    quaternions = rng.normal(size=(num_gaussians, 4))
    return GaussianCloud(
        means=np.where(trunk[:, None], bark, leaves).astype(np.float32),
        quaternions=(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(np.float32),
        scales=(np.exp(rng.normal(size=(num_gaussians, 3)) * 0.4) * [0.02, 0.015, 0.003]).astype(np.float32),
        opacity=rng.uniform(0.3, 1, num_gaussians).astype(np.float32),
        sh=(rng.normal(size=(num_gaussians, 16, 3)) * 0.2).astype(np.float32),
    )


def run() -> dict[str, object]:
    cloud = gaussian_tree(NUM_GAUSSIANS)
    camera = Camera.orbit(cloud.means)
    drawn = time_calls(lambda: render_cloud(cloud, camera, width=512, height=512), runs=15)
    wide = Camera.orbit(cloud.means, aspect=16 / 9)
    large = time_calls(lambda: render_cloud(cloud, wide, width=1920, height=1080), runs=5)
    return {
        "value": round(drawn.median_ms, 1),
        "unit": "ms",
        "target": TARGET_MS,
        "best": round(drawn.best_ms, 1),
        "p90": round(drawn.p90_ms, 1),
        "processor_ms": round(drawn.cpu_ms, 1),
        "at_1080p_ms": round(large.median_ms, 1),
        "num_gaussians": NUM_GAUSSIANS,
        "sh_degree": cloud.sh_degree,
        "size": "512 × 512",
        **machine("numpy", "numba"),
    }
