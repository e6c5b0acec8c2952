"""Time per frame of the exact step of modal coordinates alone [µs], at K = 16. The paper: 13 ms with the vertices."""

import numpy as np

from benchmarks._interaction import scene
from benchmarks._machine import machine, time_calls
from dynamictree.modal.force import Impulse, contact_at_voxel
from dynamictree.modal.response import group_forces, respond

TARGET_US = 50.0
NUM_FRAMES = 600


def run() -> dict[str, object]:
    system = scene().system
    top = int(np.argmax(system.grid.coords[:, 2]))
    groups = group_forces([Impulse(at=contact_at_voxel(system.grid, top), impulse_n_s=(5.0, 1.0, 0.0))], falloff_m=1.0)
    whole = time_calls(lambda: respond(system, groups, dt_s=1 / 60, num_frames=NUM_FRAMES), runs=30)
    return {
        "value": round(whole.median_ms * 1e3 / NUM_FRAMES, 3),
        "unit": "µs/frame",
        "target": TARGET_US,
        "p90": round(whole.p90_ms * 1e3 / NUM_FRAMES, 3),
        "paper_ms": 13.0,
        "sizes": {"frames": NUM_FRAMES, "modes": system.num_modes, "groups": len(groups)},
        **machine("numpy", "scipy", "numba"),
    }
