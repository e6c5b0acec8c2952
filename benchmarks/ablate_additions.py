"""The paper's recipe in small with additions, one at a time, and on other grids: 100 steps on 24 trees, three seeds.

Enough to tell the direction of large effects, not their size. Judged by voxel on a weeping tree, a palm and a pine,
which are never trained on: sizes and frequencies of the voxels against the truth's, and how much neighbours differ.
A line per training goes to standard error. DYNAMICTREE_BENCHMARK_VARIANTS names those to run, separated by semicolons.
"""

import json
import os
import resource
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from jaxtyping import Int32

from benchmarks._machine import machine
from dynamictree.diffusion.loss import LocalSmoothness, nearest_voxels
from dynamictree.diffusion.prediction import Prediction
from dynamictree.models import MotionModel, load_model
from dynamictree.models.paper.network import ADDITIONS, PaperPreset, with_additions
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.graph import voxel_graph
from dynamictree.voxel.voxelize import SurfaceVoxels
from lab.dataset.sample import Sample, is_training_seed, make_sample, voxel_spectrum
from lab.dataset.shards import StoredTree, store, write_shard
from lab.evaluation.metrics import (
    amplitude,
    centroid_correlation,
    log_amplitude_agreement,
    phase_agreement,
    roughness,
    smoothness_loss,
)
from lab.paper.train import paper_small_training, train_paper

NUM_TREES, STEPS, SEEDS = 24, 100, 3
JUDGED = ((5, "weeping"), (3, "palm"), (7, "pine"))


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A recipe."""

    additions: tuple[str, ...] = ()
    prediction: Prediction = "velocity"
    smoothness_from: int = STEPS
    resolution: int = 32


VARIANTS = {
    "plain, ε": Variant(prediction="noise"),
    "plain, ε, 16³": Variant(prediction="noise", resolution=16),
    "plain, ε, 64³": Variant(prediction="noise", resolution=64),
    "plain": Variant(),
    "wind": Variant(additions=("wind",)),
    "amplitude": Variant(additions=("amplitude",)),
    "amplitude, stems": Variant(additions=("amplitude", "stems")),
    "amplitude, noise along the tree": Variant(additions=("amplitude", "noise")),
    "all": Variant(additions=ADDITIONS),
    "all, ε": Variant(additions=ADDITIONS, prediction="noise"),
    "all, L_LSS in the second half": Variant(additions=ADDITIONS, smoothness_from=STEPS // 2),
}


def run() -> dict[str, object]:
    torch.set_num_threads(1)
    rows: dict[str, list[dict[str, float]]] = {}
    chosen = os.environ.get("DYNAMICTREE_BENCHMARK_VARIANTS", ";".join(VARIANTS)).split(";")
    with TemporaryDirectory() as name:
        folder = Path(name)
        with (folder / "shard.safetensors").open("wb") as stream:
            write_shard(list(islice(_training_trees(), NUM_TREES)), stream)
        for seed in range(SEEDS):
            for variant in chosen:
                row = _figures(_trained(folder, VARIANTS[variant], seed))
                rows.setdefault(variant, []).append(row)
                print(json.dumps({"variant": variant, "seed": seed, **row}), file=sys.stderr, flush=True)
    return {
        "value": {variant: _mean_and_error(own) for variant, own in rows.items()},
        "unit": "see keys; mean and standard error",
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "sizes": {"trees": NUM_TREES, "judged": len(JUDGED), "steps": STEPS, "seeds": SEEDS},
        **machine("torch", "numpy"),
    }


def _training_trees() -> Iterator[StoredTree]:
    for seed in count():
        if is_training_seed(seed):
            yield store(make_sample(seed), resolutions=(128,))


def _trained(folder: Path, recipe: Variant, seed: int) -> MotionModel:
    plain = paper_small_training()
    preset = on_grid(plain.preset, recipe.resolution)
    plan = replace(
        plain,
        preset=replace(with_additions(preset, recipe.additions), prediction=recipe.prediction),
        num_steps=STEPS,
        smoothness_from=recipe.smoothness_from,
        time_shifts="amplitude" in recipe.additions,
        save_every=10**6,
        save_every_s=1e9,
        figures_every_s=None,
        seed=seed,
    )
    train_paper(plan, [str(folder / "shard.safetensors")], folder, weights=folder / "trained.safetensors")
    (folder / "checkpoint.safetensors").unlink()
    return load_model(str(folder / "trained.safetensors"))


def on_grid(preset: PaperPreset, resolution: int) -> PaperPreset:
    """A preset whose spectra lie on another grid, and whose encoder reads the same one as before."""
    levels = (preset.condition_resolution // resolution).bit_length()
    widths = tuple(preset.encoder_base << level for level in range(levels))
    return replace(preset, resolution=resolution, encoder_widths=widths)


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """A tree and its true motion."""

    sample: Sample
    voxels: SurfaceVoxels
    truth: SparseVoxelSpectrum
    edges: Int32[np.ndarray, "E 2"]


@cache
def _judged() -> Sequence[Judged]:
    trees = []
    for seed, species in JUDGED:
        sample = make_sample(seed, species)
        voxels, truth = voxel_spectrum(sample)
        edges = np.stack(voxel_graph(voxels.grid).nonzero(), axis=1)
        trees.append(Judged(sample=sample, voxels=voxels, truth=truth, edges=edges))
    return trees


def _figures(model: MotionModel) -> dict[str, float]:
    """Means over trees."""
    rows = []
    for tree in _judged():
        truth, edges = tree.truth.coefficients, tree.edges
        guess = model.generate(tree.voxels, wind=tree.sample.wind, seed=0).coefficients
        correlation, rmse = log_amplitude_agreement(guess, truth, tree.sample.mesh.height_m)
        near = nearest_voxels(tree.voxels.grid.centres_m, LocalSmoothness().num_neighbours)
        rows.append(
            {
                "log_amplitude_correlation": correlation,
                "log_amplitude_rmse": rmse,
                "centroid_correlation": centroid_correlation(guess, truth),
                "roughness_ratio": roughness(guess, edges) / roughness(truth, edges),
                "smoothness_loss_ratio": smoothness_loss(guess, *near) / smoothness_loss(truth, *near),
                "size_ratio": float(np.median(amplitude(guess)) / np.median(amplitude(truth))),
                "phase_agreement_less_truth": phase_agreement(guess, edges) - phase_agreement(truth, edges),
            }
        )
    return {name: round(float(np.mean([row[name] for row in rows])), 3) for name in rows[0]}


def _mean_and_error(rows: Sequence[dict[str, float]]) -> dict[str, tuple[float, float]]:
    """Mean over seeds and its standard error."""
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return {
        name: (round(float(one.mean()), 3), round(float(one.std(ddof=1) / np.sqrt(len(one))), 3))
        for name, one in columns.items()
    }
