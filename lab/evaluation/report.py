"""Compare a model with its baselines on trees that no training saw: one row of figures per method."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Complex64, Float64

from dynamictree.method import devoxelize
from dynamictree.models import MotionModel, load_model
from dynamictree.models.small.generate import SmallModel
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.voxelize import voxelize
from lab.dataset.sample import is_training_seed
from lab.evaluation.baselines import (
    ByHeight,
    TrainingTree,
    fit_by_height,
    regression,
    training_tree,
)
from lab.evaluation.clip import ClipEmbedder
from lab.evaluation.figures import TreeReference, figures_of
from lab.evaluation.frame_distances import distance_error, motion_distances
from lab.evaluation.held_out_trees import Group, HeldOutTree, iter_held_out, iter_sapling
from lab.evaluation.metrics import energy_by_frequency, relative_difference
from lab.evaluation.targets import RULE, passes, targets_of
from lab.training.progress import OnStep

DRAWN_METHODS = ("truth", "model", "by-height mean", "second wind")
"""Whose frames are drawn for CLIP; the truth comes first."""


@dataclass(frozen=True, kw_only=True)
class Methods:
    """The model and the fitted baselines."""

    model: MotionModel
    by_height: ByHeight
    training_trees: Sequence[TrainingTree]


def iter_motions(
    reference: TreeReference, methods: Methods, *, seed: int, num_steps: int | None = None
) -> Iterator[tuple[str, Complex64[np.ndarray, "N K 3"]]]:
    """Each method's motion of the tree's vertices [m].

    - model
    - regression: the small model's amplitudes with one random phase per frequency
    - by-height mean: geometric mean of the training trees by height
    - representation: the true motion, voxelized and back
    - second wind: the true motion of the same tree in other gusts, which is what chance makes; only of grown trees
    """
    tree, model = reference.tree, methods.model
    rng = np.random.default_rng([seed, 1])

    def on_vertices(coefficients: Complex64[np.ndarray, "V K 3"]) -> Complex64[np.ndarray, "N K 3"]:
        return devoxelize(SparseVoxelSpectrum(grid=tree.voxels.grid, coefficients=coefficients), tree.mesh)

    generated = generate_for(tree, model, seed=seed, num_steps=num_steps)
    yield "model", devoxelize(generated, tree.mesh)
    if isinstance(model, SmallModel):
        yield "regression", on_vertices(regression(model, tree.voxels, tree.wind, rng))
    yield "by-height mean", on_vertices(methods.by_height.spectrum(tree.voxels.grid, tree.wind, rng))
    yield "representation", on_vertices(reference.on_voxels(tree.truth))
    if tree.second is not None:
        yield "second wind", tree.second


def generate_for(
    tree: HeldOutTree, model: MotionModel, *, seed: int, num_steps: int | None = None
) -> SparseVoxelSpectrum:
    """The model's motion of a tree, voxelized at the model's resolution."""
    fits = tree.voxels.grid.resolution == model.resolution
    voxels = tree.voxels if fits else voxelize(tree.mesh, model.resolution)
    return model.generate(voxels, wind=tree.wind, seed=seed, num_steps=num_steps)


def seed_difference(tree: HeldOutTree, model: MotionModel, num_steps: int | None) -> tuple[float, float] | None:
    """Relative difference of two seeds, and of two true winds if known; √2 where they have nothing in common."""
    if tree.second is None:
        return None
    first, second = (generate_for(tree, model, seed=seed, num_steps=num_steps).coefficients for seed in (0, 1))
    return relative_difference(first, second), relative_difference(tree.truth, tree.second)


def evaluate_model(
    name: str,
    *,
    num_trees: int,
    num_training: int,
    first_seed: int,
    seed: int,
    num_steps: int | None = None,
    sapling: Sequence[Path] = (),
    embedder: ClipEmbedder | None = None,
    on_step: OnStep = lambda part, done, total, loss: None,
) -> dict[str, Any]:
    """Mean figures by group and method, the targets, and whether the model passes.

    Args:
        name: of a model, or its weights file.
        num_trees: of each group.
        num_training: training trees that the baselines are fitted to.
        first_seed: of those.
        seed: of the generated motions.
        num_steps: of the sampler.
        sapling: files of trees that Blender's add-on baked, a third group.
        embedder: gives distances of frames for `DRAWN_METHODS`.
        on_step: called with the group, the trees done, their number, and 0.
    """
    model = load_model(name)
    trees = training_trees(num_training, first_seed, on_step)
    methods = Methods(model=model, by_height=fit_by_height(trees), training_trees=trees)
    begun = time.process_time()
    reports = {
        group: evaluate_group(own, methods, seed=seed, num_steps=num_steps, embedder=embedder, on_step=on_step)
        for group in get_args(Group)
        if (own := trees_of_group(group, num_trees, sapling)).count
    }
    between = np.mean([one.seed_difference for one in reports.values() if one.seed_difference is not None], axis=0)
    return {
        "model": model.name,
        "trees": {group: one.count for group, one in reports.items()},
        "groups": {group: one.figures for group, one in reports.items()},
        "energy_by_frequency": {group: one.energies for group, one in reports.items()},
        "frame_distances": {group: one.frame_distances for group, one in reports.items() if one.frame_distances},
        "seed_difference": {"model": float(between[0]), "truth": float(between[1])},
        "targets": targets_of(reports["unseen-species"].figures),
        "rule": RULE,
        "passes": all(passes(one.figures) for group, one in reports.items() if group != "sapling"),
        "cpu_seconds": round(time.process_time() - begun, 1),
    }


@dataclass(frozen=True, kw_only=True)
class GroupReport:
    """Means over a group's trees, by method."""

    count: int
    figures: dict[str, dict[str, float]]
    energies: dict[str, list[float]]
    frame_distances: dict[str, dict[str, float]]
    seed_difference: tuple[float, float] | None


@dataclass(frozen=True, kw_only=True)
class TreeGroup:
    """Trees, generated lazily, and their number."""

    group: Group
    trees: Iterator[HeldOutTree]
    count: int


def evaluate_group(
    group: TreeGroup,
    methods: Methods,
    *,
    seed: int,
    num_steps: int | None,
    embedder: ClipEmbedder | None,
    on_step: OnStep,
) -> GroupReport:
    """Measure every method on every tree of a group."""
    rows: dict[str, list[dict[str, float]]] = {}
    drawn: dict[str, list[dict[str, float]]] = {}
    shares: dict[str, list[Float64[np.ndarray, " J"]]] = {}
    difference = None
    for index, tree in enumerate(group.trees):
        reference = TreeReference.of(tree)
        true_distances = (0.0, 0.0)
        motions = chain([("truth", tree.truth)], iter_motions(reference, methods, seed=seed, num_steps=num_steps))
        for method, motion in motions:
            shares.setdefault(method, []).append(energy_by_frequency(motion))
            if method != "truth":
                rows.setdefault(method, []).append(asdict(figures_of(motion, reference)))
            if embedder is not None and method in DRAWN_METHODS:
                seen = motion_distances(embedder, tree.mesh, motion)
                true_distances = seen if method == "truth" else true_distances
                error = distance_error(seen, true_distances)
                drawn.setdefault(method, []).append({"clip_i": seen[0], "clip_t": seen[1], "clip_error": error})
        if index == 0:
            difference = seed_difference(tree, methods.model, num_steps)
        on_step(group.group, index + 1, group.count, 0.0)
    return GroupReport(
        count=group.count,
        figures={method: mean_of(of_method) for method, of_method in rows.items()},
        energies={method: np.mean(one, axis=0).round(5).tolist() for method, one in shares.items()},
        frame_distances={method: mean_of(of_method) for method, of_method in drawn.items()},
        seed_difference=difference,
    )


def trees_of_group(group: Group, num_trees: int, sapling: Sequence[Path]) -> TreeGroup:
    """A group's trees."""
    if group == "sapling":
        return TreeGroup(group=group, trees=iter_sapling(sapling), count=len(sapling))
    return TreeGroup(group=group, trees=iter_held_out(group, num_trees), count=num_trees)


def training_trees(count: int, first_seed: int, on_step: OnStep) -> list[TrainingTree]:
    """The first `count` training trees from a seed on."""
    trees: list[TrainingTree] = []
    seed = first_seed
    while len(trees) < count:
        if is_training_seed(seed):
            trees.append(training_tree(seed))
            on_step("training trees", len(trees), count, 0.0)
        seed += 1
    return trees


def mean_of(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Mean of each figure over trees."""
    return {figure: float(np.mean([one[figure] for one in rows])) for figure in rows[0]}
