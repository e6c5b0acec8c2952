"""The model and what it must beat, on trees that no training saw: one row of figures a method."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Complex64, Float64

from dynamictree.evaluation.baselines import ByHeight, fit_by_height, nearest_tree, noise_only, regression
from dynamictree.evaluation.clip import ImageEmbedder, motion_distances
from dynamictree.evaluation.figures import Ruler, judge
from dynamictree.evaluation.held_out_trees import Group, JudgedTree, iter_judged, iter_sapling
from dynamictree.evaluation.metrics import energy_by_frequency, relative_difference
from dynamictree.evaluation.targets import RULE, passes, targets_of
from dynamictree.models.small.examples import Example, is_training_seed, make_example
from dynamictree.models.small.generate import TreeMotionModel, load_model
from dynamictree.training.progress import OnStep
from dynamictree.voxel.inextensible import bending

SEEN_BY_CLIP = ("truth", "model", "by-height mean")


@dataclass(frozen=True, kw_only=True)
class Knowledge:
    """The model, and what the baselines know."""

    model: TreeMotionModel
    by_height: ByHeight
    examples: Sequence[Example]


def iter_motions(
    ruler: Ruler, known: Knowledge, *, seed: int, num_steps: int | None = None
) -> Iterator[tuple[str, Complex64[np.ndarray, "N K 3"]]]:
    """Each method's motion of the tree's vertices [m].

    The model; the amplitude network with one random phase a frequency (regression), and times the noise that the
    diffusion starts from (noise only); the training mean by height; the most alike training tree's motion; the truth
    through the voxels and back (representation); and the same tree in other gusts (second wind): what chance makes.
    """
    tree, model = ruler.tree, known.model
    rng = np.random.default_rng([seed, 1])
    interpolation = bending(tree.voxels.grid, tree.mesh)
    generated = model.generate(tree.voxels, wind=tree.wind, seed=seed, num_steps=num_steps).coefficients
    yield "model", interpolation.apply(generated)
    yield "regression", interpolation.apply(regression(model, tree.voxels, tree.wind, rng))
    yield "noise only", interpolation.apply(noise_only(model, tree.voxels, tree.wind, seed))
    yield "by-height mean", interpolation.apply(known.by_height.spectrum(tree.voxels.grid, tree.wind, rng))
    yield "nearest tree", interpolation.apply(nearest_tree(tree.voxels, tree.wind, known.examples))
    yield "representation", interpolation.apply(ruler.on_voxels(tree.truth))
    yield "second wind", tree.second


def seed_difference(tree: JudgedTree, model: TreeMotionModel) -> tuple[float, float]:
    """How far two seeds are apart, and two true winds; √2 where they have nothing in common."""
    first, second = (model.generate(tree.voxels, wind=tree.wind, seed=seed).coefficients for seed in (0, 1))
    return relative_difference(first, second), relative_difference(tree.truth, tree.second)


def evaluate_model(
    name: str,
    *,
    num_trees: int,
    num_known: int,
    first_seed: int,
    seed: int,
    num_steps: int | None = None,
    sapling: Sequence[Path] = (),
    embedder: ImageEmbedder | None = None,
    on_step: OnStep = lambda part, done, total, loss: None,
) -> dict[str, Any]:
    """Mean figures a group and method, the targets, and whether the model passes.

    Args:
        name: of a shipped model, or a file.
        num_trees: of each group.
        num_known: training trees that the baselines know.
        first_seed: of those.
        seed: of the generated motions.
        num_steps: of the sampler.
        sapling: files of trees that Blender's add-on baked, a third group.
        embedder: CLIP, for CLIP-I and CLIP-T of the model, the truth and the by-height mean.
        on_step: told the group, the trees done and their number.
    """
    model = load_model(name)
    examples = known_examples(model.network.preset.resolution, num_known, first_seed, on_step)
    known = Knowledge(model=model, by_height=fit_by_height(examples), examples=examples)
    told = {
        group: judge_group(judged, known, seed=seed, num_steps=num_steps, embedder=embedder, on_step=on_step)
        for group in get_args(Group)
        if (judged := judged_trees(group, num_trees, sapling, model.network.preset.resolution)).count
    }
    between = np.mean([one.seed_difference for one in told.values()], axis=0)
    return {
        "model": model.name,
        "trees": {group: one.count for group, one in told.items()},
        "groups": {group: one.figures for group, one in told.items()},
        "energy_by_frequency": {group: one.energies for group, one in told.items()},
        **({"clip": {group: one.clip for group, one in told.items()}} if embedder is not None else {}),
        "seed_difference": {"model": float(between[0]), "truth": float(between[1])},
        "targets": targets_of(told["unseen-species"].figures),
        "rule": RULE,
        "passes": all(passes(one.figures) for group, one in told.items() if group != "sapling"),
    }


@dataclass(frozen=True, kw_only=True)
class Told:
    """A group's means by method."""

    count: int
    figures: dict[str, dict[str, float]]
    energies: dict[str, list[float]]
    clip: dict[str, dict[str, float]]
    seed_difference: tuple[float, float]


def judge_group(
    judged: "JudgedGroup",
    known: Knowledge,
    *,
    seed: int,
    num_steps: int | None,
    embedder: ImageEmbedder | None,
    on_step: OnStep,
) -> Told:
    """Every method on every tree of a group."""
    rows: dict[str, list[dict[str, float]]] = {}
    clip: dict[str, list[dict[str, float]]] = {}
    shares: dict[str, list[Float64[np.ndarray, " J"]]] = {}
    difference = (0.0, 0.0)
    for index, tree in enumerate(judged.trees):
        ruler = Ruler.of(tree)
        motions = chain([("truth", tree.truth)], iter_motions(ruler, known, seed=seed, num_steps=num_steps))
        for method, motion in motions:
            shares.setdefault(method, []).append(energy_by_frequency(motion))
            if method != "truth":
                rows.setdefault(method, []).append(asdict(judge(motion, ruler)))
            if embedder is not None and method in SEEN_BY_CLIP:
                near, smooth_in_time = motion_distances(embedder, tree.mesh, motion)
                clip.setdefault(method, []).append({"clip_i": near, "clip_t": smooth_in_time})
        if index == 0:
            difference = seed_difference(tree, known.model)
        on_step(judged.group, index + 1, judged.count, 0.0)
    return Told(
        count=judged.count,
        figures={method: mean_of(of_method) for method, of_method in rows.items()},
        energies={method: np.mean(one, axis=0).round(5).tolist() for method, one in shares.items()},
        clip={method: mean_of(of_method) for method, of_method in clip.items()},
        seed_difference=difference,
    )


@dataclass(frozen=True, kw_only=True)
class JudgedGroup:
    """Trees, made as they are asked for, and their number."""

    group: Group
    trees: Iterator[JudgedTree]
    count: int


def judged_trees(group: Group, num_trees: int, sapling: Sequence[Path], resolution: int) -> JudgedGroup:
    """A group's trees."""
    if group == "sapling":
        return JudgedGroup(group=group, trees=iter_sapling(sapling, resolution=resolution), count=len(sapling))
    return JudgedGroup(group=group, trees=iter_judged(group, num_trees, resolution=resolution), count=num_trees)


def known_examples(resolution: int, count: int, first_seed: int, on_step: OnStep) -> list[Example]:
    """The first `count` training trees from a seed on."""
    known: list[Example] = []
    candidate = first_seed
    while len(known) < count:
        if is_training_seed(candidate):
            known.append(make_example(candidate, resolution))
            on_step("training trees", len(known), count, 0.0)
        candidate += 1
    return known


def mean_of(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Mean of each figure over trees."""
    return {figure: float(np.mean([one[figure] for one in rows])) for figure in rows[0]}
