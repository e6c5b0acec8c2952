"""MB/s at which a splat's motion is written as PLY files in a ZIP, beside the disk's own rate."""

import os
import tempfile
import time

import numpy as np

from benchmarks._machine import machine
from benchmarks._scene import sheet
from dynamictree.formats.motion.splat_sequence import iter_splat_sequence_zip, splat_sequence_bytes
from dynamictree.gaussian.from_mesh import splats_of_mesh

NUM_GAUSSIANS, NUM_FRAMES = 100_000, 20


def run() -> dict[str, object]:
    from dataclasses import replace

    mesh = sheet(20_000)
    binding = splats_of_mesh(mesh, at_least=NUM_GAUSSIANS, rng=np.random.default_rng(0)).binding
    sh = np.random.default_rng(0).normal(size=(binding.cloud.num_gaussians, 16, 3)).astype(np.float32)
    binding = replace(binding, cloud=replace(binding.cloud, sh=sh))
    frames = [(0.2 * np.sin(mesh.vertices[:, [1, 2, 0]] + n)).astype(np.float32) for n in range(NUM_FRAMES)]
    size = splat_sequence_bytes(binding.cloud.num_gaussians, 3, NUM_FRAMES)
    for _ in iter_splat_sequence_zip(binding, frames[:1]):
        pass  # compiled
    sequence = _rate(iter_splat_sequence_zip(binding, frames))
    block = bytes(1 << 20)
    disk = _rate(block for _ in range(size >> 20))
    return {
        "value": round(sequence, 0),
        "unit": "MB/s",
        "disk_mb_s": round(disk, 0),
        "size_mb": round(size / 1e6, 1),
        "num_gaussians": binding.cloud.num_gaussians,
        "sh_degree": 3,
        "num_frames": NUM_FRAMES,
        **machine("numpy", "numba"),
    }


def _rate(chunks) -> float:  # type: ignore[no-untyped-def]
    with tempfile.TemporaryFile() as file:
        start = time.perf_counter()
        for chunk in chunks:
            file.write(chunk)
        file.flush()
        os.fsync(file.fileno())
        return file.tell() / 1e6 / (time.perf_counter() - start)
