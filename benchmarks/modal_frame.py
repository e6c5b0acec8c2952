"""Total time per frame from modes to 100,000 vertices and 500,000 Gaussians [ms]. The paper: 15.57 ms on a GPU."""

from collections.abc import Iterator

import numpy as np

from benchmarks._interaction import bent_by, gaussians_on, scene
from benchmarks._machine import machine, ratio_to_copy, time_calls, time_copy
from benchmarks.deform_gaussians import frame_bytes
from dynamictree.gaussian.deform import Deformer
from dynamictree.modal.step import State, exact_step
from dynamictree.modal.step import run as run_modes

TARGET_MS = 8.0
FLOOR_TARGET = 2.5  # ratio to the time of copying a frame's bytes


def run() -> dict[str, object]:
    prepared = scene()
    system, mesh, grid = prepared.system, prepared.mesh, prepared.spectrum.grid
    tree = prepared.tree()
    displacement = bent_by(tree)
    deformer = Deformer(gaussians_on(mesh))
    shuffled = Deformer(gaussians_on(mesh, in_face_order=False))
    states = coordinates_after_impulse(system)

    def vertices() -> np.ndarray:
        return displacement(next(states))

    def all_in() -> object:
        return deformer.pose(vertices())

    moved, weights = vertices(), tree.rig.vertices
    figures = {
        "vertices": time_calls(vertices),
        "gaussians": time_calls(lambda: deformer.pose(moved)),
        "all_in": time_calls(all_in),
        "all_in_gaussians_in_any_order": time_calls(lambda: shuffled.pose(vertices())),
    }
    return {
        "value": round(figures["all_in"].median_ms, 4),
        "unit": "ms/frame",
        "target": TARGET_MS,
        **ratio_to_copy(
            figures["all_in"],
            time_copy(weights.rows.nbytes + weights.shares.nbytes + 2 * moved.nbytes + frame_bytes(deformer.binding)),
        ),
        "over_floor_target": FLOOR_TARGET,
        "parts": {name: figure.rounded() for name, figure in figures.items()},
        "paper_ms": 15.57,
        "sizes": {
            "vertices": mesh.num_vertices,
            "gaussians": len(deformer.binding.face_of),
            "voxels": len(grid),
            "modes": system.num_modes,
            "bones": len(tree.rig.skeleton),
        },
        **machine("numpy", "scipy", "numba"),
    }


def coordinates_after_impulse(system) -> Iterator[np.ndarray]:
    """Yield coordinates endlessly after a knock; each call computes one step, since the step is part of the frame."""
    step = exact_step(system, 1 / 60)
    rng = np.random.default_rng(0)
    state = State(
        q=np.zeros((1, system.num_modes), complex),
        q_dot=rng.normal(size=(1, system.num_modes)) * system.omega + 0j,
    )
    still = np.zeros((1, 1, system.num_modes), complex)
    while True:
        frames, state = run_modes(step, state, still)
        yield frames[0]
