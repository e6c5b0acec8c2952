"""From voxels to a spectrum with the shipped models: s at 7,000 and 20,000 voxels of a 128³ grid, and peak memory."""

import resource
from time import perf_counter, process_time

import numpy as np
import torch

from benchmarks._machine import machine, timed
from benchmarks._trees import demo_mesh
from dynamictree.models import load_model
from dynamictree.models.small.generate import NUM_STEPS
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels, voxelize
from lab.dataset.sample import make_sample

TARGET_S = 10.0
NUM_VOXELS = 7000
PAPER_RUNS = ((7000, 20), (7000, 100), (20_000, 20), (20_000, 100))
"""Voxels and steps of DDIM; targets at 7,000 voxels on two idle cores: 15 s with 20 steps, 60 s with 100."""
SEED, SPECIES = 3, "columnar"


def run() -> dict[str, object]:
    voxels = _lowest(voxelize(make_sample(SEED, SPECIES).mesh, 128), NUM_VOXELS)
    model = load_model("small")
    sampled = timed(lambda: model.generate(voxels, wind=Wind(), seed=0), runs=3)
    peak_mb = _peak_mb()
    demo = voxelize(demo_mesh(), 128)
    return {
        "value": round(sampled.median_ms / 1e3, 2),
        "unit": "s",
        "target": TARGET_S,
        "p90": round(sampled.p90_ms / 1e3, 2),
        "peak_memory_mb": peak_mb,
        "paper_small": [_paper_row(demo, *of_run) for of_run in PAPER_RUNS],
        "sizes": {"voxels": len(voxels.grid), "resolution": 128, "steps": NUM_STEPS},
        "threads": torch.get_num_threads(),
        **machine("torch", "numpy"),
    }


def _paper_row(tree: SurfaceVoxels, num_voxels: int, num_steps: int) -> dict[str, float]:
    voxels, model = _lowest(tree, num_voxels), load_model("paper-small")
    began, worked = perf_counter(), process_time()
    model.generate(voxels, wind=Wind(), seed=0, num_steps=num_steps)
    return {
        "voxels": len(voxels.grid),
        "steps": num_steps,
        "s": round(perf_counter() - began, 1),
        "processor_s": round(process_time() - worked, 1),
        "peak_memory_mb": _peak_mb(),
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
