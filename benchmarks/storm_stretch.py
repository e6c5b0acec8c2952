"""Stretch of edges and leaf cards in the model's motion for a storm, per tree.

Values are 99th percentiles over a loop [%]: of the frames with flutter, as in every product and on the page, of those
without, and of the sum of these frames' K frequencies, as in `glb-morph`.
"""

import numpy as np

from benchmarks._machine import machine
from benchmarks._stretch import Sizes, trees
from dynamictree import method
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Wind
from dynamictree.rig.flutter import fluttering
from dynamictree.rig.rig import rig_of
from dynamictree.rig.surface_skeleton import surface_bones
from dynamictree.spectrum import iter_motion

SPEEDS_M_S = (20.0, 30.0)
LOOP_FRAMES = 24
TARGET_PERCENT = 1.0


def run() -> dict[str, object]:
    rows = {name: {f"{speed:.0f}_m_s": _stretch(mesh, speed) for speed in SPEEDS_M_S} for name, mesh in trees()}
    return {
        "value": max(row["20_m_s"]["frames_edges"] for row in rows.values()),
        "unit": "% of an edge, 99th percentile of frames at 20 m/s, worst tree",
        "target": TARGET_PERCENT,
        "trees": rows,
        **machine("numpy", "torch"),
    }


def _stretch(mesh: TriangleMesh, speed_m_s: float) -> dict[str, float]:
    spectrum = method.generate(method.voxelize(mesh), wind=Wind(speed_m_s=speed_m_s), seed=0)
    rig = rig_of(mesh, spectrum)
    phases = np.arange(LOOP_FRAMES) / LOOP_FRAMES
    sizes = Sizes.of(mesh, surface_bones(mesh, spectrum.grid).in_card)
    moving = fluttering(rig, spectrum, 1.0)
    kinds = {
        "frames": (rig.displacement(theta, mesh.vertices, rig.vertices) for theta in moving.theta(phases)),
        "calm": (rig.displacement(theta, mesh.vertices, rig.vertices) for theta in rig.theta(phases)),
        "added": iter_motion(rig.loop(mesh.vertices, rig.vertices), phases, spectrum.num_frames),
    }
    row = {}
    for kind, motion in kinds.items():
        row[f"{kind}_edges"], row[f"{kind}_cards"] = sizes.growth_percent(motion)
    return row
