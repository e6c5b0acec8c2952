"""Compare a model with its baselines on held-out trees: one row of figures per method."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Complex64, Float64

from dynamictree.method import devoxelize
from dynamictree.models import MotionModel, load_model
from dynamictree.models.gust_travel import delay_downwind
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.voxelize import voxelize
from lab.dataset.sample import is_training_seed
from lab.evaluation.baselines import ByHeight, TrainingTree, fit_by_height, training_tree
from lab.evaluation.clip import ClipEmbedder
from lab.evaluation.figures import TreeReference, figures_of
from lab.evaluation.frame_distances import distance_error, motion_distances
from lab.evaluation.held_out_trees import Group, HeldOutTree, iter_held_out, iter_sapling
from lab.evaluation.metrics import energy_by_frequency
from lab.training.progress import OnStep

DRAWN_METHODS = ("truth", "model", "by-height mean", "second wind")
"""Methods whose frames are rendered for CLIP; the truth comes first."""

FLOOR = "second wind"
MAX_ROUGHNESS_ERROR = 0.5
RULE = (
    "log-amplitude RMSE below the by-height mean's, and roughness within 50 % of the truth's, "
    "on seen and on unseen species"
)


@dataclass(frozen=True, kw_only=True)
class Methods:
    """The model and the fitted baseline."""

    model: MotionModel
    by_height: ByHeight


def iter_motions(
    reference: TreeReference, methods: Methods, *, seed: int, num_steps: int | None = None
) -> Iterator[tuple[str, Complex64[np.ndarray, "N K 3"]]]:
    """Yield each method's motion of the tree's vertices [m].

    - model
    - by-height mean: geometric mean of the training trees by height
    - representation: the true motion, voxelized and back
    - second wind: the true motion of the same tree in other gusts, the effect of chance; only of generated trees
    """
    tree, model = reference.tree, methods.model
    rng = np.random.default_rng([seed, 1])

    def on_vertices(coefficients: Complex64[np.ndarray, "V K 3"]) -> Complex64[np.ndarray, "N K 3"]:
        return devoxelize(SparseVoxelSpectrum(grid=tree.voxels.grid, coefficients=coefficients), tree.mesh)

    generated = generate_for(tree, model, seed=seed, num_steps=num_steps)
    yield "model", devoxelize(generated, tree.mesh)
    yield "by-height mean", on_vertices(methods.by_height.spectrum(tree.voxels.grid, tree.wind, rng))
    yield "representation", on_vertices(reference.on_voxels(tree.truth))
    if tree.second is not None:
        yield "second wind", tree.second


def generate_for(
    tree: HeldOutTree, model: MotionModel, *, seed: int, num_steps: int | None = None
) -> SparseVoxelSpectrum:
    """Generate the model's motion of a tree, voxelized at the model's resolution."""
    fits = tree.voxels.grid.resolution == model.resolution
    voxels = tree.voxels if fits else voxelize(tree.mesh, model.resolution)
    spectrum = model.generate(voxels, wind=tree.wind, seed=seed, num_steps=num_steps)
    return delay_downwind(spectrum, tree.wind) if model.adds_gust_travel else spectrum


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
    """Compute mean figures by group and method, the targets, and whether the model passes.

    The baselines are fitted to `num_training` trees from `first_seed` on. Files of trees that Blender's add-on baked
    are a third group; the embedder computes distances of frames for `DRAWN_METHODS`.
    """
    model = load_model(name)
    by_height = fit_by_height(training_trees(num_training, first_seed, on_step))
    methods = Methods(model=model, by_height=by_height)
    begun = time.process_time()
    reports = {
        group: evaluate_group(own, methods, seed=seed, num_steps=num_steps, embedder=embedder, on_step=on_step)
        for group in get_args(Group)
        if (own := trees_of_group(group, num_trees, sapling)).count
    }
    return {
        "model": model.name,
        "trees": {group: one.count for group, one in reports.items()},
        "groups": {group: one.figures for group, one in reports.items()},
        "energy_by_frequency": {group: one.energies for group, one in reports.items()},
        "frame_distances": {group: one.frame_distances for group, one in reports.items() if one.frame_distances},
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
        on_step(group.group, index + 1, group.count, 0.0)
    return GroupReport(
        count=group.count,
        figures={method: mean_of(of_method) for method, of_method in rows.items()},
        energies={method: np.mean(one, axis=0).round(5).tolist() for method, one in shares.items()},
        frame_distances={method: mean_of(of_method) for method, of_method in drawn.items()},
    )


def trees_of_group(group: Group, num_trees: int, sapling: Sequence[Path]) -> TreeGroup:
    """Return a group's trees."""
    if group == "sapling":
        return TreeGroup(group=group, trees=iter_sapling(sapling), count=len(sapling))
    return TreeGroup(group=group, trees=iter_held_out(group, num_trees), count=num_trees)


def training_trees(count: int, first_seed: int, on_step: OnStep) -> list[TrainingTree]:
    """Generate the first `count` training trees from a seed on."""
    trees: list[TrainingTree] = []
    seed = first_seed
    while len(trees) < count:
        if is_training_seed(seed):
            trees.append(training_tree(seed))
            on_step("training trees", len(trees), count, 0.0)
        seed += 1
    return trees


def mean_of(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the mean of each figure over trees."""
    return {figure: float(np.mean([one[figure] for one in rows])) for figure in rows[0]}


@dataclass(frozen=True, kw_only=True)
class Target:
    """A bound on one figure."""

    figure: str
    sense: Literal["at least", "at most", "within"]
    bound: float

    def error(self, value: float) -> float:
        """Return the distance of a value from the bound; 0 if it meets the bound."""
        beyond = {"at least": self.bound - value, "at most": value - self.bound, "within": abs(value - 1) - self.bound}
        return max(0.0, beyond[self.sense])


TARGETS = (
    Target(figure="log_amplitude_correlation", sense="at least", bound=0.93),
    Target(figure="log_amplitude_rmse", sense="at most", bound=0.25),
    Target(figure="centroid_correlation", sense="at least", bound=0.8),
    Target(figure="roughness_ratio", sense="within", bound=0.2),
    Target(figure="stretch_p99", sense="at most", bound=0.05),
    Target(figure="root_share", sense="at most", bound=0.005),
    Target(figure="loop_jump", sense="at most", bound=1.0),
)


def targets_of(methods: Mapping[str, Mapping[str, float]]) -> list[dict[str, object]]:
    """Return, for each target, the model's value, whether it meets the bound, and by how much it misses.

    `floor` is the same figure for the true motion in other gusts: no model can be expected to do better.
    """
    return [
        {
            "figure": target.figure,
            "wanted": f"{target.sense} {target.bound:g}" + (" of 1" if target.sense == "within" else ""),
            "value": methods["model"][target.figure],
            "floor": methods[FLOOR][target.figure],
            "met": target.error(methods["model"][target.figure]) == 0,
            "missed_by": target.error(methods["model"][target.figure]),
        }
        for target in TARGETS
    ]


def passes(methods: Mapping[str, Mapping[str, float]]) -> bool:
    """Return whether the weights may ship, by RULE."""
    model, baseline = methods["model"], methods["by-height mean"]
    better = model["log_amplitude_rmse"] < baseline["log_amplitude_rmse"]
    return better and abs(model["roughness_ratio"] - 1) <= MAX_ROUGHNESS_ERROR
