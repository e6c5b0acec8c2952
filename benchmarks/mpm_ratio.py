"""Ratio of frame times of one tree: material point method at PhysGaussian's settings over modes.

Both run on both cores; particles are the same 500,000 Gaussians, 20,000 of them in a second row. A frame of the MPM
is 400 substeps, of which some are timed. The rival is our `benchmarks._mpm`, tested against a free fall. The paper's
table has 1,800 ms for PhysGaussian and 18.22 ms for itself: a ratio of 99.
"""

import numpy as np

from benchmarks import _mpm as mpm
from benchmarks._interaction import bent_by, gaussians_on, scene
from benchmarks._machine import Timing, machine, time_calls
from benchmarks.modal_frame import coordinates_after_impulse
from dynamictree.gaussian.deform import Deformer

TARGET = 1000.0
TIMED_SUBSTEPS = 12
NS_LIMIT = 250.0


def run() -> dict[str, object]:
    prepared = scene()
    displacement = bent_by(prepared.tree())
    binding = gaussians_on(prepared.mesh)
    deformer, states = Deformer(binding), coordinates_after_impulse(prepared.system)
    ours = time_calls(lambda: deformer.pose(displacement(next(states))))
    some = np.random.default_rng(2).choice(len(binding.cloud.means), 20_000, replace=False)
    rows = {
        "500,000 particles": _mpm_row(binding.cloud.means, ours),
        "20,000 particles": _mpm_row(binding.cloud.means[some], ours),
    }
    again = time_calls(lambda: deformer.pose(displacement(next(states))))
    return {
        "value": rows["500,000 particles"]["ratio"],
        "unit": "times",
        "target": TARGET,
        "ours_ms_a_frame": ours.rounded() | {"again_after_the_rival": round(again.median_ms, 4)},
        "mpm": rows,
        "paper": {"PhysGaussian_ms": 1800, "DynamicTree_ms": 18.22, "ratio": 99},
        "sizes": {"vertices": prepared.mesh.num_vertices, "voxels": len(prepared.spectrum.grid), "grid": mpm.GRID},
        "settings": {
            "dt_s": mpm.DT_S,
            "substeps_a_frame": mpm.SUBSTEPS_PER_FRAME,
            "young_pa": mpm.YOUNG,
            "poisson": mpm.POISSON,
            "density": mpm.DENSITY,
            "timed_substeps": TIMED_SUBSTEPS,
        },
        **machine("numpy", "scipy", "numba"),
    }


def _mpm_row(points: np.ndarray, ours: Timing) -> dict[str, object]:
    particles = mpm.particles_at(points.astype(np.float64))
    particles.velocity[:, 0] = 0.5 * (particles.position[:, 2] - particles.position[:, 2].min())
    floor = float(particles.position[:, 2].min()) + 0.1
    rival = time_calls(lambda: mpm.advance(particles, num_substeps=1, floor=floor), runs=TIMED_SUBSTEPS, warm_ups=2)
    assert np.isfinite(particles.position).all()
    frame_ms = rival.median_ms * mpm.SUBSTEPS_PER_FRAME
    return {
        "ms_a_frame": round(frame_ms, 1),
        "ms_a_frame_at_best": round(rival.best_ms * mpm.SUBSTEPS_PER_FRAME, 1),
        "ns_a_particle_and_substep": round(rival.median_ms * 1e6 / len(points), 1),
        "ns_limit": NS_LIMIT,
        "ratio": round(frame_ms / ours.median_ms, 1),
        "cpu_ns_a_particle_and_substep": round(rival.cpu_ms * 1e6 / len(points), 1),
        "ratio_of_processor_time": round(rival.cpu_ms * mpm.SUBSTEPS_PER_FRAME / ours.cpu_ms, 1),
    }
