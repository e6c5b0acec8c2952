"""One 3³ submanifold convolution, forward and with gradients: ms by voxels and channels, against the dense one."""

import numpy as np
import torch
from torch.nn import functional

from benchmarks._blobs import walk_coords
from benchmarks._machine import machine, timed
from dynamictree.sparse.conv import SubmanifoldConv
from dynamictree.sparse.level import sparse_level

VOXELS = (2000, 4000, 8000, 16000)
CHANNELS = (32, 64, 128)
RESOLUTION = 128
DENSE_RESOLUTION = 64  # a dense 128³ layer of 32 channels is 0.27 GB and seconds; reported is the time of 64³, times 8


def run() -> dict[str, object]:
    rng = np.random.default_rng(0)
    table = []
    for voxels in VOXELS:
        level = sparse_level(torch.from_numpy(walk_coords(voxels, RESOLUTION, rng)))
        neighbours = 1 + 2 * sum(len(first) for first, _ in level.pairs) / voxels
        for channels in CHANNELS:
            conv, features = SubmanifoldConv(channels, channels), torch.randn(voxels, channels, requires_grad=True)
            with torch.no_grad():
                forward = timed(lambda c=conv, f=features, g=level: c(f, g), runs=5)
            both = timed(lambda c=conv, f=features, g=level: c(f, g).sum().backward(), runs=5)
            table.append(
                {
                    "voxels": voxels,
                    "channels": channels,
                    "occupied_of_27": round(neighbours, 1),
                    "forward_ms": round(forward.median_ms, 2),
                    "with_gradients_ms": round(both.median_ms, 2),
                }
            )
    dense = torch.randn(1, 32, *[DENSE_RESOLUTION] * 3)
    kernel = torch.randn(32, 32, 3, 3, 3)
    with torch.no_grad():
        dense_s = timed(lambda: functional.conv3d(dense, kernel, padding=1), runs=2).median_ms / 1e3
    at_32 = {row["voxels"]: float(str(row["forward_ms"])) for row in table if row["channels"] == 32}
    return {
        "value": at_32[8000],
        "unit": "ms",
        "target": 20.0,
        "growth_16000_over_4000": round(at_32[16000] / at_32[4000], 2),  # 4 is linear
        "dense_128_cubed_32_channels_ms": round(8e3 * dense_s, 1),
        "table": table,
        "threads": torch.get_num_threads(),
        **machine("torch", "numpy"),
    }
