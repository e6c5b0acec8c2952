"""The paper's last table: one clean mesh, animated by our model and by Sapling's procedural wind.

The paper's own figures come from a user study (authenticity, complexity, structure, quality). Measured here is what
needs no true motion: smoothness, stretch, roots, loop, number of frequencies, time, CLIP.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex64

from dynamictree.devoxelize.length_preserving import length_preserving
from dynamictree.models import MotionModel, load_model
from dynamictree.spectrum import FPS, NUM_FRAMES, from_motion
from lab.evaluation import metrics
from lab.evaluation.figures import TreeReference
from lab.evaluation.frame_distances import ImageEmbedder, motion_distances
from lab.evaluation.held_out_trees import HeldOutTree, iter_held_out, iter_sapling
from lab.evaluation.procedural_wind import sway_as_sapling
from lab.evaluation.report import generate_for, mean_of
from lab.evaluation.sapling_file import read_sapling
from lab.training.progress import OnStep

Motion = Complex64[np.ndarray, "N K 3"]
ALL_BINS = NUM_FRAMES // 2 + 1
"""A motion that does not loop needs every bin, to be the same motion again."""

CONTESTANTS = {
    "model": "ours: from the mesh alone",
    "sapling": "the add-on's formula on the tree's own skeleton, made to loop",
    "sapling, as baked": "the add-on's own frames (trees of its own only)",
    "4dtree wind": "the wind of the training data, on the tree's own skeleton (our trees only)",
}


@dataclass(frozen=True, kw_only=True)
class Showing:
    """Figures of one method on one tree that need no true motion."""

    smoothness_loss: float  # L_LSS of the voxels' means, over their mean size
    roughness: float  # along the mesh's edges
    phase_agreement: float
    stretch_median: float
    stretch_p99: float
    root_share: float  # of the height
    loop_jump: float  # over the largest step inside
    size_share: float  # median size of the motion, of the height
    effective_frequencies: float  # exp of the entropy of the energy's shares by frequency
    mean_frequency_hz: float
    cpu_seconds: float  # to make the loop; 0 where it was read


def show(motion: Motion, reference: TreeReference, *, seconds: float) -> Showing:
    """Measure a motion."""
    vertices = reference.tree.mesh.vertices
    median, extreme = metrics.edge_stretch(motion, vertices, reference.edges)
    shares = metrics.energy_by_frequency(motion)
    some = shares[shares > 0]
    return Showing(
        smoothness_loss=reference.smoothness(motion),
        roughness=metrics.roughness(motion, reference.edges),
        phase_agreement=metrics.phase_agreement(motion, reference.edges),
        stretch_median=median,
        stretch_p99=extreme,
        root_share=metrics.root_share(motion, vertices),
        loop_jump=metrics.loop_jump(motion),
        size_share=float(np.median(metrics.amplitude(motion)) / reference.tree.mesh.height_m),
        effective_frequencies=float(np.exp(-(some * np.log(some)).sum())),
        mean_frequency_hz=float(shares @ np.arange(1, len(shares) + 1) * FPS / NUM_FRAMES),
        cpu_seconds=seconds,
    )


def iter_contest(tree: HeldOutTree, model: MotionModel, seed: int) -> Iterator[tuple[str, Motion, float]]:
    """Each contestant's motion of the tree's vertices [m], and the CPU seconds that it took."""
    begun = time.process_time()
    spectrum = generate_for(tree, model, seed=seed)
    motion = length_preserving(spectrum.grid, tree.mesh).apply(spectrum.coefficients)
    yield "model", motion, time.process_time() - begun
    begun = time.process_time()
    swayed = sway_as_sapling(tree.bones, np.random.default_rng([seed, 2]))
    motion = from_motion(swayed.displacement(tree.mesh.vertices, tree.bone), ALL_BINS)
    yield "sapling", motion, time.process_time() - begun


def compare(
    name: str,
    *,
    num_trees: int,
    seed: int,
    sapling: Sequence[Path] = (),
    embedders: Sequence[ImageEmbedder] = (),
    on_step: OnStep = lambda part, done, total, loss: None,
) -> dict[str, Any]:
    """Mean figures per set of trees and method; distances of frames for each image network."""
    model = load_model(name)
    sets: dict[str, tuple[Iterator[tuple[HeldOutTree, str, Motion]], int]] = {
        "sapling trees": (_their_trees(sapling), len(sapling)),
        "unseen species": (_our_trees(num_trees), num_trees),
    }
    report: dict[str, dict[str, dict[str, float]]] = {}
    for kind, (trees, count) in sets.items():
        rows: dict[str, list[dict[str, float]]] = {}
        for done, (tree, another, their_motion) in enumerate(trees, start=1):
            reference = TreeReference.of(tree)
            for contestant, motion, seconds in chain(iter_contest(tree, model, seed), [(another, their_motion, 0.0)]):
                row = asdict(show(motion, reference, seconds=seconds))
                for embedder in embedders:
                    distances = motion_distances(embedder, tree.mesh, motion)
                    row[f"{embedder.name}_i"], row[f"{embedder.name}_t"] = distances
                rows.setdefault(contestant, []).append(row)
            on_step(kind, done, count, 0.0)
        if rows:
            report[kind] = {contestant: mean_of(of_one) for contestant, of_one in rows.items()}
    return {"model": model.name, "trees": {kind: count for kind, (_, count) in sets.items()}, "sets": report}


def _their_trees(files: Sequence[Path]) -> Iterator[tuple[HeldOutTree, str, Motion]]:
    for path, tree in zip(files, iter_sapling(files), strict=True):
        yield tree, "sapling, as baked", from_motion(read_sapling(path).displacement, ALL_BINS)


def _our_trees(count: int) -> Iterator[tuple[HeldOutTree, str, Motion]]:
    for tree in iter_held_out("unseen-species", count):
        yield tree, "4dtree wind", tree.truth
