"""Milliseconds a frame that colours of SH degree 3 cost more where 500,000 Gaussians turn: two ways.

The view direction turned back in the renderer, as we do to draw; or the coefficients turned, as we do to write.
"""

import numpy as np

from benchmarks._machine import machine, timed
from benchmarks.render_frame import crown
from dynamictree.gaussian.rasterize import _view
from dynamictree.gaussian.rasterize_kernel import project
from dynamictree.gaussian.rotation import quaternion_products
from dynamictree.gaussian.turn import turn_sh_fast
from dynamictree.parallel import in_bands
from dynamictree.render.camera import Camera

NUM_GAUSSIANS = 500_000
SIDE_PX = 512


def run() -> dict[str, object]:
    cloud = crown(NUM_GAUSSIANS)
    turn = np.tile(np.array([np.cos(0.1), 0, np.sin(0.1), 0]), (NUM_GAUSSIANS, 1))
    now = quaternion_products(turn, cloud.quaternions.astype(np.float64)).astype(np.float32)
    view = _view(Camera.orbit(cloud.means), SIDE_PX, SIDE_PX)
    ellipses, bounds = np.zeros((NUM_GAUSSIANS, 10), np.float32), np.zeros((NUM_GAUSSIANS, 4), np.int32)

    def seen(turned: bool) -> None:
        given = (cloud.means, now, cloud.scales, cloud.opacity, cloud.sh, cloud.quaternions, view)
        in_bands(project, NUM_GAUSSIANS, *given, True, turned, ellipses, bounds)

    turns = turn.astype(np.float32)
    straight, back = (timed(lambda turned=turned: seen(turned), runs=15) for turned in (False, True))
    turning = timed(lambda: turn_sh_fast(cloud.sh, turns), runs=7)
    extra, coefficients = back.cpu_ms - straight.cpu_ms, turning.cpu_ms
    return {
        "value": round(extra, 2),
        "unit": "ms of all cores' processor time",
        "turning_coefficients": round(coefficients, 1),
        "ratio": round(coefficients / max(extra, 0.01), 1),
        "wall_ms": {
            "without_a_turn": round(straight.median_ms, 1),
            "direction_turned_back": round(back.median_ms, 1),
            "coefficients_turned": round(turning.median_ms, 1),
        },
        "moved_mb": round(2 * cloud.sh.nbytes / 1e6),
        "num_gaussians": NUM_GAUSSIANS,
        "sh_degree": 3,
        **machine("numpy", "numba"),
    }
