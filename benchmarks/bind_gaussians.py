"""Time to bind 500,000 captured Gaussians to a mesh of 100,000 faces."""

import time

import numpy as np

from benchmarks._gaussian_scene import wavy_sheet
from benchmarks._machine import machine
from dynamictree.gaussian.binding import bind
from dynamictree.gaussian.cloud import GaussianCloud

NUM_GAUSSIANS = 500_000
TARGET_S = 10.0


def capture(vertices: np.ndarray) -> GaussianCloud:
    """Return Gaussians about 2 cm off a surface, in random order."""
    rng = np.random.default_rng(0)
    quaternions = rng.normal(size=(NUM_GAUSSIANS, 4))
    near = vertices[rng.integers(0, len(vertices), NUM_GAUSSIANS)] + rng.normal(size=(NUM_GAUSSIANS, 3)) * 0.02
    return GaussianCloud(
        means=near.astype(np.float32),
        quaternions=(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(np.float32),
        scales=np.full((NUM_GAUSSIANS, 3), 0.01, np.float32),
        opacity=np.full(NUM_GAUSSIANS, 0.5, np.float32),
        sh=np.zeros((NUM_GAUSSIANS, 1, 3), np.float32),
    )


def run() -> dict[str, object]:
    mesh = wavy_sheet(100_000)
    cloud = capture(mesh.vertices)
    bind(cloud.subset(np.arange(10)), mesh)  # compiles
    times = []
    for _ in range(3):
        start = time.perf_counter()
        bind(cloud, mesh)
        times.append(time.perf_counter() - start)
    return {
        "value": round(float(np.median(times)), 2),
        "unit": "s",
        "target": TARGET_S,
        "best": round(min(times), 2),
        "num_gaussians": NUM_GAUSSIANS,
        "num_faces": mesh.num_faces,
        **machine("numpy", "numba"),
    }
