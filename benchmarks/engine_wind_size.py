"""How much an engine stretches a tree when it blends the product `wind` to a storm, tree by tree.

Beside it a plain sum of modes. Stretch of edges and change of area of cards, 99th percentile in per cent over two
minutes of 20 m/s; the motion is the model's for 8 m/s. And how far the bones are from the product's frames in the loop
of that motion's own wind, in per cent of the motion.
"""

import zipfile
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks._engine_wind import read_engine_wind
from benchmarks._machine import machine
from benchmarks._stretch import Sizes, trees
from dynamictree import method
from dynamictree.export.vertex_motion import vertex_motion
from dynamictree.export.write import write_products
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.turbulence import iter_turbulent_motion, turbulent_wind
from dynamictree.modal.turn_skeleton import turn_skeleton
from dynamictree.requests import ExportParams, Wind
from dynamictree.spectrum import iter_motion

STORM_M_S, SECONDS = 20.0, np.linspace(0, 120, 25)
LOOP_FRAMES = 24


def run() -> dict[str, object]:
    rows = {name: _compared(mesh) for name, mesh in trees()}
    return {
        "value": max(row["edges_percent"] for row in rows.values()),
        "unit": "% of an edge, 99th percentile in a storm, worst tree",
        "target": 2.0,
        "trees": rows,
        **machine("numpy", "torch", "OpenEXR"),
    }


def _compared(mesh: TriangleMesh) -> dict[str, float]:
    spectrum = method.generate(method.voxelize(mesh), wind=Wind(speed_m_s=8.0), seed=0)
    with TemporaryDirectory() as folder:
        path = write_products(mesh, spectrum, ExportParams(formats=("wind",)), Path(folder))["wind"]
        megabytes = path.stat().st_size / 1e6
        with zipfile.ZipFile(path) as archive:
            engine = read_engine_wind(archive)
    vertices, pose = vertex_motion(mesh, spectrum, every_frame=True, on_progress=lambda done: None)
    own = turbulent_wind(spectrum, seed=spectrum.seed)
    storm = replace(own, wind=replace(own.wind, speed_m_s=STORM_M_S))
    summed = iter_turbulent_motion(vertices.coefficients, storm, SECONDS, spectrum.num_frames)
    shipped = (engine.displacement(seconds, STORM_M_S) for seconds in SECONDS.tolist())
    skeleton = turn_skeleton(mesh, spectrum.grid)
    sizes = Sizes.of(mesh, skeleton.in_card)
    row = {"vertices": mesh.num_vertices, "in_cards_percent": round(100 * float(skeleton.in_card.mean()), 1)}
    for suffix, motion in (("", shipped), ("_summed", summed)):
        row["edges_percent" + suffix], row["cards_percent" + suffix] = sizes.growth_percent(motion)
    phases = np.arange(LOOP_FRAMES) / LOOP_FRAMES
    linear = iter_motion(vertices.coefficients, phases, spectrum.num_frames)
    error = power = 0.0
    assert pose is not None
    for phase, frame in zip(phases.tolist(), pose.iter_poses(linear), strict=True):
        turn = np.exp(2j * np.pi * phase * np.arange(spectrum.num_frequencies))
        error += float(((engine.pose(turn) - frame) ** 2).sum())
        power += float((frame**2).sum())
    return row | {
        "own_wind_error_percent": round(100 * float(np.sqrt(error / power)), 2),
        "bones": len(engine.parent),
        "most_ancestors": int(skeleton.depths.max()),
        "look_ups_a_frame": _look_ups(skeleton.depths, len(engine.turns)),
        "megabytes": round(megabytes, 2),
    }


def _look_ups(depths: np.ndarray, num_modes: int) -> int:
    """Of the pass that computes the bones: of each texel the bone itself, then its modes and those of each ancestor."""
    turn = num_modes + 1  # and the direction
    return int(len(depths) * (4 * 2 + 2 * turn) + depths.sum() * (turn + 3))
