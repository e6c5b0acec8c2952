"""Classifier that separates generated from true motions: gradient-boosted trees on features of whole motions.

The result is valid only if the same classifier also separates an easy fake, the by-height mean, from the truth: RULE.
True and generated motions are of the same trees in the same winds, and a tree is never on both sides of a split. All
pass through the same voxels. Roots are left out: a model's are clamped, and those of voxels move by 8e-6 of the height.
The raw truth, without voxels, is one of the fakes: differences that reveal it are not errors of the model.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any, get_args

import numpy as np
from jaxtyping import Complex64, Float64, Int64

from dynamictree.errors import InputError
from dynamictree.method import devoxelize
from dynamictree.models import load_model
from dynamictree.spectrum import SparseVoxelSpectrum
from lab.evaluation.baselines import fit_by_height
from lab.evaluation.figures import TreeReference
from lab.evaluation.held_out_trees import HeldOutTree, SpeciesGroup, iter_held_out
from lab.evaluation.metrics import (
    FLOOR,
    ROOT_SHARE,
    amplitude,
    centroid,
    downwind_lean,
    edge_stretch,
    energy_by_frequency,
    loop_jump,
    phase_agreement,
    roughness,
)
from lab.evaluation.report import generate_for, training_trees
from lab.training.progress import OnStep

KINDS = ("by-height mean", "model", "second wind", "raw truth")
MIN_ACCURACY = 0.9
RULE = f"valid if it separates the by-height mean in at least {100 * MIN_ACCURACY:.0f} % of cases"
FOLDS = 5
HEIGHTS = 5  # number of slices over the height for sizes
FRAMES = 12  # number of frames in which edges are measured
FIRST_TRAINING_SEED = 1000


def features_of(motion: Complex64[np.ndarray, "N K 3"], reference: TreeReference) -> dict[str, float]:
    """Compute features of a motion, of its tree and of its wind."""
    tree = reference.tree
    vertices, height_m = tree.mesh.vertices, tree.mesh.height_m
    above = (vertices[:, 2] - vertices[:, 2].min()) / height_m
    crown = above > ROOT_SHARE
    above = above[crown]
    size = np.log(np.maximum(amplitude(motion)[crown] / height_m, FLOOR))
    bins = centroid(motion)[crown]
    slices = np.minimum((above * HEIGHTS).astype(int), HEIGHTS - 1)
    median, extreme = edge_stretch(motion, vertices, reference.edges, num_frames=FRAMES)
    features = {
        "speed": tree.wind.speed_m_s,
        "gust": tree.wind.gust,
        "height": height_m,
        "voxels": float(len(tree.voxels.grid)),
        "roughness": roughness(motion, reference.edges),
        "smoothness_loss": reference.smoothness(motion),
        "phase_agreement": phase_agreement(motion, reference.edges),
        "stretch_median": median,
        "stretch_p99": extreme,
        "loop_jump": loop_jump(motion),
        "lean": downwind_lean(motion, vertices, tree.wind.direction_deg),
        "size_over_lean": float(size.mean()) - float(np.log(np.linalg.norm(motion[:, 0].real, axis=1).mean() + 1e-9)),
        "bin_spread": float(bins.std()),
        "bin_with_size": float(np.corrcoef(bins, size)[0, 1]),
        "size_with_height": float(np.corrcoef(above, size)[0, 1]),
        **_axes(motion, tree),
    }
    features |= {f"size_p{at}": float(np.percentile(size, at)) for at in (5, 25, 50, 75, 95)}
    features |= {f"bin_p{at}": float(np.percentile(bins, at)) for at in (5, 50, 95)}
    features |= {f"energy_{k}": float(share) for k, share in enumerate(np.log(energy_by_frequency(motion)), start=1)}
    for part in range(HEIGHTS):
        inside = slices == part
        features[f"size_at_{part}"] = float(size[inside].mean()) if inside.any() else np.nan
        features[f"spread_at_{part}"] = float(size[inside].std()) if inside.any() else np.nan
    return features


def _axes(motion: Complex64[np.ndarray, "N K 3"], tree: HeldOutTree) -> dict[str, float]:
    """Return the shares of the energy along the wind, across it and vertical."""
    angle = np.deg2rad(tree.wind.direction_deg)
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    power = (np.abs(motion[:, 1:] @ turn.T) ** 2).sum(axis=(0, 1))
    return dict(zip(("along", "across", "upright"), (power / power.sum()).tolist(), strict=True))


def classify(
    name: str,
    *,
    num_trees: int,
    max_voxels: int,
    seed: int,
    num_training: int = 40,
    tries: int = 50,
    on_step: OnStep = lambda part, done, total, loss: None,
) -> dict[str, Any]:
    """Return a classifier's accuracy in separating each kind of motion from the true one; 0.5 is chance.

    Trees of seen and unseen species come in turn, each with a seed of its own; larger ones than `max_voxels` are left
    out, up to `tries` for each that is small enough. The by-height mean is fitted to `num_training` trees.

    Raises:
        InputError: too few trees are small enough, or scikit-learn is not installed.
    """
    model = load_model(name)
    by_height = fit_by_height(training_trees(num_training, FIRST_TRAINING_SEED, on_step))
    rows: dict[str, list[dict[str, float]]] = {kind: [] for kind in ("truth", *KINDS)}
    voxels: list[int] = []
    for tree in _small_trees(num_trees, max_voxels, tries):
        assert tree.second is not None, "grown trees have one"
        own_seed = seed + len(voxels)
        rng = np.random.default_rng([own_seed, 1])
        reference, on_vertices = TreeReference.of(tree), partial(_on_vertices, tree)
        generated = generate_for(tree, model, seed=own_seed)
        mean = by_height.spectrum(tree.voxels.grid, tree.wind, rng)
        motions = {
            # the truth passes through voxels too, so that their loss reveals nothing
            "truth": on_vertices(reference.on_voxels(tree.truth)),
            "second wind": on_vertices(reference.on_voxels(tree.second)),
            "model": devoxelize(generated, tree.mesh),
            "by-height mean": on_vertices(mean),
        }
        motions["raw truth"] = tree.truth
        for kind, motion in motions.items():
            rows[kind].append(features_of(motion, reference))
        voxels.append(len(tree.voxels.grid))
        on_step("trees", len(voxels), num_trees, 0.0)
    tables = {kind: np.array([list(row.values()) for row in of_kind]) for kind, of_kind in rows.items()}
    right = {kind: cross_validate(tables["truth"], tables[kind], seed=seed) for kind in KINDS}
    return {
        "model": model.name,
        "trees": num_trees,
        "mean_voxels": float(np.mean(voxels)),
        "features": list(rows["truth"][0]),
        "right": right,
        "valid": right["by-height mean"] >= MIN_ACCURACY,
        "rule": RULE,
    }


def _on_vertices(tree: HeldOutTree, coefficients: Complex64[np.ndarray, "V K 3"]) -> Complex64[np.ndarray, "N K 3"]:
    return devoxelize(SparseVoxelSpectrum(grid=tree.voxels.grid, coefficients=coefficients), tree.mesh)


def _small_trees(count: int, max_voxels: int, tries: int) -> Iterator[HeldOutTree]:
    """Iterate over trees of seen and unseen species in turn, without large ones."""
    groups: tuple[SpeciesGroup, ...] = get_args(SpeciesGroup)
    both = [iter_held_out(group, tries * count) for group in groups]
    given = 0
    while given < count:
        tree = next(both[given % 2], None)
        if tree is None:
            raise InputError(f"hardly a tree has at most {max_voxels:,} voxels; allow more with --max-voxels")
        if len(tree.voxels.grid) <= max_voxels:
            given += 1
            yield tree


def cross_validate(truth: Float64[np.ndarray, "P D"], fake: Float64[np.ndarray, "P D"], *, seed: int) -> float:
    """Return the cross-validated accuracy of a classifier on held-out trees. Row i of both inputs is tree i."""
    try:
        from sklearn.ensemble import HistGradientBoostingClassifier
        from sklearn.model_selection import GroupKFold
    except ImportError as error:
        raise InputError("the classifier needs scikit-learn; install dynamictree[lab]") from error
    features = np.concatenate([truth, fake])
    is_fake = np.repeat([0, 1], [len(truth), len(fake)])
    tree: Int64[np.ndarray, " R"] = np.concatenate([np.arange(len(truth)), np.arange(len(fake))])
    right = 0
    for learn, test in GroupKFold(FOLDS).split(features, is_fake, tree):
        network = HistGradientBoostingClassifier(random_state=seed, min_samples_leaf=8, max_iter=150)
        network.fit(features[learn], is_fake[learn])
        right += int((network.predict(features[test]) == is_fake[test]).sum())
    return right / len(features)
