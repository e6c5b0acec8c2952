"""From voxels to a spectrum with the shipped model: s at 7,000 voxels of a 128³ grid, and peak memory."""

import resource

import numpy as np
import torch

from benchmarks._machine import machine, timed
from dynamictree.models import load_model
from dynamictree.models.small.generate import NUM_STEPS
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels, voxelize
from lab.dataset.sample import make_sample

TARGET_S = 10.0
NUM_VOXELS = 7000
SEED, SPECIES = 3, "columnar"


def run() -> dict[str, object]:
    voxels = _lowest(voxelize(make_sample(SEED, SPECIES).mesh, 128), NUM_VOXELS)
    model = load_model("small")
    sampled = timed(lambda: model.generate(voxels, wind=Wind(), seed=0), runs=3)
    peak_mb = _peak_mb()
    return {
        "value": round(sampled.median_ms / 1e3, 2),
        "unit": "s",
        "target": TARGET_S,
        "p90": round(sampled.p90_ms / 1e3, 2),
        "peak_memory_mb": peak_mb,
        "sizes": {"voxels": len(voxels.grid), "resolution": 128, "steps": NUM_STEPS},
        "threads": torch.get_num_threads(),
        **machine("torch", "numpy"),
    }


def _peak_mb() -> int:
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def _lowest(voxels: SurfaceVoxels, count: int) -> SurfaceVoxels:
    """The part of a tree that has at most `count` voxels: what lies below some height."""
    grid = voxels.grid
    lowest = np.sort(np.argsort(grid.coords[:, 2], kind="stable")[:count])
    part = VoxelGrid(
        coords=grid.coords[lowest], origin_m=grid.origin_m, voxel_size_m=grid.voxel_size_m, resolution=grid.resolution
    )
    moments = None if voxels.moments is None else voxels.moments[lowest]
    return SurfaceVoxels(grid=part, normals=voxels.normals[lowest], moments=moments)
