"""Time per frame to move 500,000 Gaussians with 100,000 faces [ms]. Paper table 2: 2.57 ms on a GPU."""

import numpy as np

from benchmarks._gaussian_scene import wavy_sheet
from benchmarks._machine import machine, ratio_to_copy, time_calls, time_copy
from dynamictree.gaussian.deform import Deformer, Pose
from dynamictree.gaussian.from_mesh import splats_of_mesh
from dynamictree.gaussian.turn import turn_sh_fast

NUM_GAUSSIANS = 500_000
TARGET_MS = 5.0
FLOOR_TARGET = 2.0  # ratio to the time of copying a frame's bytes


def run() -> dict[str, object]:
    mesh = wavy_sheet(100_000)
    binding = splats_of_mesh(mesh, at_least=NUM_GAUSSIANS, rng=np.random.default_rng(0)).binding
    displacement = (0.2 * np.sin(mesh.vertices[:, [1, 2, 0]])).astype(np.float32)
    deformer = Deformer(binding)
    out = Pose.empty(binding.cloud.num_gaussians)
    posed = time_calls(lambda: deformer.pose(displacement, out=out))
    floor = time_copy(frame_bytes(binding))
    shuffled = Deformer(_shuffled(binding))
    in_any_order = time_calls(lambda: shuffled.pose(displacement, out=out), runs=20)
    sh = np.random.default_rng(0).normal(size=(100_000, 16, 3)).astype(np.float32)
    turns = binding.cloud.quaternions[:100_000]
    return {
        "value": round(posed.median_ms, 3),
        "unit": "ms",
        "target": TARGET_MS,
        "best": round(posed.best_ms, 3),
        "p90": round(posed.p90_ms, 3),
        "processor_ms": round(posed.cpu_ms, 3),
        **ratio_to_copy(posed, floor),
        "over_floor_target": FLOOR_TARGET,
        "shuffled_ms": round(in_any_order.median_ms, 3),
        "shuffled_processor_ms": round(in_any_order.cpu_ms, 3),
        "turn_sh3_ms": round(time_calls(lambda: turn_sh_fast(sh, turns), runs=10).median_ms * 5, 1),
        "num_gaussians": binding.cloud.num_gaussians,
        "num_faces": len(binding.triangles),
        **machine("numpy", "numba"),
    }


def frame_bytes(binding) -> int:  # type: ignore[no-untyped-def]
    """Return the minimum of bytes that a frame reads or writes: rest pose, face rows, and the pose."""
    return binding.cloud.num_gaussians * (15 + 1 + 10) * 4 + len(binding.triangles) * (13 + 3 + 9 + 16) * 4


def _shuffled(binding):  # type: ignore[no-untyped-def]
    """Return the binding in random order, as captures may have it."""
    from dataclasses import replace

    order = np.random.default_rng(1).permutation(binding.cloud.num_gaussians)
    return replace(
        binding, cloud=binding.cloud.subset(order), face_of=binding.face_of[order], weights=binding.weights[order]
    )
