"""How much a motion that the model makes for a storm stretches edges and leaf cards, tree by tree.

99th percentiles in per cent over a loop of the motion: of frames as `vat`, `usd` and films have them, of the
frequencies of these frames at the keys of a `glb` and halfway between, and of the voxels' frequencies added, as
`/interact` does.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from benchmarks._machine import machine
from benchmarks._stretch import Sizes, trees
from dynamictree import method
from dynamictree.devoxelize.length_preserving import ignore_progress
from dynamictree.export.vertex_motion import MotionSource
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.turn_skeleton import turn_skeleton
from dynamictree.requests import Wind
from dynamictree.spectrum import iter_motion

SPEEDS_M_S = (20.0, 30.0)
LOOP_FRAMES = 24
TARGET_PERCENT = 2.0


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
    source = MotionSource(mesh=mesh, spectrum=spectrum)
    motion = source.motion(ignore_progress)
    phases = np.arange(LOOP_FRAMES) / LOOP_FRAMES
    linear = iter_motion(motion.linear, phases, spectrum.num_frames)
    again = iter_motion(motion.coefficients, phases, spectrum.num_frames)
    frames = again if motion.bent is None else source.pose(motion).iter_poses(again)
    sizes = Sizes.of(mesh, turn_skeleton(mesh, spectrum.grid).in_card)
    kinds: dict[str, Iterable[np.ndarray]] = {
        "frames": frames,
        "glb": _keyed(motion.loop, spectrum.num_frames),
        "added": linear,
    }
    row = {"glb_targets": 2 * motion.loop.shape[1] - 1.0}
    for kind, motion_of_kind in kinds.items():
        row[f"{kind}_edges"], row[f"{kind}_cards"] = sizes.growth_percent(motion_of_kind)
    return row


def _keyed(loop: np.ndarray, num_frames: int) -> Iterator[np.ndarray]:
    """What a player shows of linear keys: LOOP_FRAMES of them, and the middles to the next."""
    first = np.arange(LOOP_FRAMES) * num_frames // LOOP_FRAMES
    keys = (iter_motion(loop, (first + step) / num_frames, num_frames) for step in (0, 1))
    for key, following in zip(*keys, strict=True):
        yield key.copy()
        yield (key + following) / 2
