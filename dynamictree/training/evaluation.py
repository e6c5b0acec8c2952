"""The model and what it must beat, on trees that no training saw: one row of figures a method."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np
from jaxtyping import Complex64

from dynamictree.diffusion.model import TreeMotionModel, load_model
from dynamictree.mesh import edges_of
from dynamictree.training.baselines import ByHeight, fit_by_height, nearest_tree, noise_only, regression
from dynamictree.training.examples import Example, is_training_seed, make_example
from dynamictree.training.metrics import (
    amplitude,
    centroid_correlation,
    downwind_lean,
    edge_stretch,
    energy_by_frequency,
    log_amplitude_agreement,
    log_spectral_distance,
    loop_jump,
    phase_agreement,
    relative_difference,
    root_share,
    roughness,
)
from dynamictree.training.trees import Group, JudgedTree, iter_judged
from dynamictree.voxel.devoxelize import smooth
from dynamictree.voxel.voxelize import surface_average

METHODS = {
    "model": "the diffusion model",
    "regression": "amplitude network, one random phase a frequency",
    "noise only": "amplitude network times the noise that the diffusion starts from",
    "by-height mean": "training mean by height, one random phase a frequency",
    "nearest tree": "the most alike training tree's motion",
    "representation": "the truth through the voxels and back",
    "second wind": "the same tree in other gusts: what chance alone makes",
}


MAX_ROUGHNESS_ERROR = 0.5
RULE = (
    "log-amplitude RMSE below the by-height mean's, and roughness within 50 % of the truth's, "
    "on seen and on unseen species"
)


@dataclass(frozen=True, kw_only=True)
class Figures:
    """One method on one tree. Ratios are to the truth's own figure."""

    log_amplitude_correlation: float
    log_amplitude_rmse: float
    log_spectral_distance: float
    centroid_correlation: float
    roughness_ratio: float
    energy_distance: float  # half the sum of |differences| of the shares of energy by frequency
    size_ratio: float  # median of a over the truth's
    stretch_median: float
    stretch_p99: float
    root_share: float  # of the height
    loop_jump: float  # over the largest step inside
    lean_ratio: float
    phase_agreement: float
    phase_agreement_truth: float


def judge(guess: Complex64[np.ndarray, "N K 3"], tree: JudgedTree) -> Figures:
    """Every figure of one motion."""
    vertices, height_m = tree.mesh.vertices, tree.mesh.height_m
    edges = edges_of(tree.mesh.faces)
    correlation, rmse = log_amplitude_agreement(guess, tree.truth, height_m)
    median, extreme = edge_stretch(guess, vertices, edges)
    lean = [downwind_lean(one, vertices, tree.wind.direction_deg) for one in (guess, tree.truth)]
    return Figures(
        log_amplitude_correlation=correlation,
        log_amplitude_rmse=rmse,
        log_spectral_distance=log_spectral_distance(guess, tree.truth, height_m),
        centroid_correlation=centroid_correlation(guess, tree.truth),
        roughness_ratio=roughness(guess, edges) / roughness(tree.truth, edges),
        energy_distance=float(np.abs(energy_by_frequency(guess) - energy_by_frequency(tree.truth)).sum() / 2),
        size_ratio=float(np.median(amplitude(guess)) / np.median(amplitude(tree.truth))),
        stretch_median=median,
        stretch_p99=extreme,
        root_share=root_share(guess, vertices),
        loop_jump=loop_jump(guess),
        lean_ratio=lean[0] / lean[1],
        phase_agreement=phase_agreement(guess, edges),
        phase_agreement_truth=phase_agreement(tree.truth, edges),
    )


def iter_motions(
    tree: JudgedTree,
    model: TreeMotionModel,
    by_height: ByHeight,
    known: Sequence[Example],
    *,
    seed: int,
    num_steps: int | None = None,
) -> Iterator[tuple[str, Complex64[np.ndarray, "N K 3"]]]:
    """Each method's motion of the tree's vertices [m]."""
    rng = np.random.default_rng([seed, 1])
    interpolation = smooth(tree.voxels.grid, tree.mesh)
    generated = model.generate(tree.voxels, wind=tree.wind, seed=seed, num_steps=num_steps).coefficients
    yield "model", interpolation.apply(generated)
    yield "regression", interpolation.apply(regression(model, tree.voxels, tree.wind, rng))
    yield "noise only", interpolation.apply(noise_only(model, tree.voxels, tree.wind, seed))
    yield "by-height mean", interpolation.apply(by_height.spectrum(tree.voxels.grid, tree.wind, rng))
    yield "nearest tree", interpolation.apply(nearest_tree(tree.voxels, tree.wind, known))
    flat = tree.truth.reshape(len(tree.truth), -1).view(np.float32)
    voxels = (surface_average(tree.mesh, tree.voxels.grid).astype(np.float32) @ flat).view(np.complex64)
    yield "representation", interpolation.apply(np.ascontiguousarray(voxels).reshape(-1, *tree.truth.shape[1:]))
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
    on_step: Callable[[str, int, int, float], None] | None = None,
) -> dict[str, Any]:
    """Mean figures a group and method, and whether the model passes: see RULE."""
    model = load_model(name)
    known: list[Example] = []
    candidate = first_seed
    while len(known) < num_known:
        if is_training_seed(candidate):
            known.append(make_example(candidate, model.network.preset.resolution))
            _tell(on_step, "training trees", len(known), num_known)
        candidate += 1
    by_height = fit_by_height(known)
    groups: dict[str, dict[str, dict[str, float]]] = {}
    differences = []
    for group in get_args(Group):
        rows: dict[str, list[dict[str, float]]] = {method: [] for method in METHODS}
        for index, tree in enumerate(iter_judged(group, num_trees, resolution=model.network.preset.resolution)):
            for method, motion in iter_motions(tree, model, by_height, known, seed=seed, num_steps=num_steps):
                rows[method].append(asdict(judge(motion, tree)))
            if index == 0:
                differences.append(seed_difference(tree, model))
            _tell(on_step, group, index + 1, num_trees)
        groups[group] = {
            method: {figure: float(np.mean([one[figure] for one in of_method])) for figure in of_method[0]}
            for method, of_method in rows.items()
        }
    between = np.mean(differences, axis=0)
    return {
        "model": model.name,
        "trees": num_trees,
        "groups": groups,
        "seed_difference": {"model": float(between[0]), "truth": float(between[1])},
        "rule": RULE,
        "passes": all(_passes(of_group) for of_group in groups.values()),
    }


def _passes(methods: dict[str, dict[str, float]]) -> bool:
    model, baseline = methods["model"], methods["by-height mean"]
    better = model["log_amplitude_rmse"] < baseline["log_amplitude_rmse"]
    return better and abs(model["roughness_ratio"] - 1) <= MAX_ROUGHNESS_ERROR


def _tell(on_step: Callable[[str, int, int, float], None] | None, part: str, done: int, total: int) -> None:
    if on_step is not None:
        on_step(part, done, total, 0.0)
