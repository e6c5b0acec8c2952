"""Time per frame of one tree as elastic rods in Newton (VBD solver, Warp's CPU backend) and by its modes [ms].

The rival moves only the skeleton's segments, without contacts, with the settings of Newton's own example of branching
rods (20 substeps of 5 iterations per frame of 1/60 s; one bending stiffness for all joints, which does not affect the
cost). Our frame also moves 500,000 Gaussians. Warp uses one CPU thread.
"""

import numpy as np

from benchmarks._interaction import SEED, SPECIES, bent_by, gaussians_on, scene
from benchmarks._machine import machine, time_calls
from benchmarks.modal_frame import coordinates_after_impulse
from dynamictree.gaussian.deform import Deformer
from lab.dataset.sample import make_sample
from lab.dataset.stem_skeleton import Skeleton

try:
    import newton
    import warp
except ImportError:
    newton = warp = None

FRAME_S, SUBSTEPS, ITERATIONS = 1 / 60, 20, 5
STRETCH_N_M, BEND_NM_RAD, BEND_DAMPING = 1e7, 5e3, 10.0
RADIUS_M = 0.02
PUSH_M_S = 0.5


class RodTree:
    """A skeleton of capsules with elastic joints; its lowest segment is fixed."""

    def __init__(self, skeleton: Skeleton) -> None:
        child = np.flatnonzero(skeleton.parent >= 0)
        edges = np.stack([skeleton.parent[child], child], axis=1)
        builder = newton.ModelBuilder()
        rod = newton.Rod([warp.vec3(*map(float, x)) for x in skeleton.position], edges=edges, radius=RADIUS_M)
        bodies, _ = builder.add_rod(
            rod=rod, stretch_stiffness=STRETCH_N_M, bend_stiffness=BEND_NM_RAD, bend_damping=BEND_DAMPING
        )
        for body in (bodies[int(row)] for row in np.flatnonzero(skeleton.parent[edges[:, 0]] < 0)):
            builder.body_mass[body] = builder.body_inv_mass[body] = 0.0
            builder.body_inertia[body] = builder.body_inv_inertia[body] = warp.mat33(0.0)
        builder.color()
        self.model = builder.finalize(device="cpu")
        self.solver = newton.solvers.SolverVBD(self.model, iterations=ITERATIONS)
        self.state, self.next = self.model.state(), self.model.state()
        self.control = self.model.control()
        self.num_bodies = len(bodies)
        heights = self.state.body_q.numpy()[:, 2]
        speed = np.zeros((self.num_bodies, 6), np.float32)
        speed[:, 0] = PUSH_M_S * heights / heights.max()
        self.state.body_qd.assign(speed)

    def frame(self) -> None:
        for _ in range(SUBSTEPS):
            self.state.clear_forces()
            self.solver.step(self.state, self.next, self.control, None, FRAME_S / SUBSTEPS)
            self.state, self.next = self.next, self.state


def run() -> dict[str, object]:
    if newton is None:
        raise SystemExit("benchmarks: rod_rival needs Newton; pip install newton warp-lang")
    prepared = scene()
    displacement = bent_by(prepared.tree())
    deformer, states = Deformer(gaussians_on(prepared.mesh)), coordinates_after_impulse(prepared.system)
    rods = RodTree(make_sample(SEED, SPECIES).skeleton)
    ours = time_calls(lambda: deformer.pose(displacement(next(states))))
    before = rods.state.body_q.numpy()[:, :3].copy()
    rival = time_calls(rods.frame)
    moved = np.linalg.norm(rods.state.body_q.numpy()[:, :3] - before, axis=1)
    assert np.isfinite(moved).all()
    again = time_calls(lambda: deformer.pose(displacement(next(states))))
    return {
        "value": round(rival.median_ms / ours.median_ms, 1),
        "unit": "times",
        "ours_ms_a_frame": ours.rounded() | {"again_after_the_rival": round(again.median_ms, 4)},
        "rods_ms_a_frame": rival.rounded(),
        "ratio_of_processor_time": round(rival.cpu_ms / ours.cpu_ms, 1),
        "rods": {"segments": rods.num_bodies, "moved_m_at_most": round(float(moved.max()), 3)},
        "settings": {"substeps": SUBSTEPS, "iterations": ITERATIONS, "frame_s": FRAME_S, "newton": newton.__version__},
        **machine("numpy", "numba"),
    }
