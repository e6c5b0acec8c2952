"""Additions to the paper's recipe, one after another, in small: `paper-small` with 120 steps on 24 trees.

Enough to tell the direction of an effect, not its size. Judged by voxel on a weeping tree, a palm and a pine, which are
never trained on: sizes and frequencies of the voxels against the truth's, and how much neighbours differ.
"""

import resource
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks._machine import machine
from dynamictree.dataset.sample import is_training_seed, make_sample, voxel_spectrum
from dynamictree.dataset.shards import StoredTree, store, write_shard
from dynamictree.evaluation.metrics import amplitude, centroid_correlation, log_amplitude_agreement, roughness
from dynamictree.models import MotionModel, load_model
from dynamictree.models.paper.network import with_additions
from dynamictree.models.paper.train import paper_small_training, train_paper
from dynamictree.voxel.graph import voxel_graph

NUM_TREES, STEPS = 24, 120
NEVER = STEPS
JUDGED = ((5, "weeping"), (3, "palm"), (7, "pine"))
VARIANTS: dict[str, tuple[tuple[str, ...], int]] = {
    "plain": ((), NEVER),
    "+ wind": (("wind",), NEVER),
    "+ amplitude": (("wind", "amplitude"), NEVER),
    "+ stems": (("wind", "amplitude", "stems"), NEVER),
    "+ noise along the tree": (("wind", "amplitude", "stems", "noise"), NEVER),
    "+ L_LSS in the second half": (("wind", "amplitude", "stems", "noise"), STEPS // 2),
}


def run() -> dict[str, object]:
    torch.set_num_threads(1)
    rows = {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        with (folder / "shard.safetensors").open("wb") as stream:
            write_shard(list(islice(_training_trees(), NUM_TREES)), stream)
        for variant in VARIANTS:
            rows[variant] = _figures(_trained(folder, variant))
    return {
        "value": rows,
        "unit": "see keys",
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "sizes": {"trees": NUM_TREES, "judged": len(JUDGED), "steps": STEPS},
        **machine("torch", "numpy"),
    }


def _training_trees() -> Iterator[StoredTree]:
    for seed in count():
        if is_training_seed(seed):
            yield store(make_sample(seed), resolutions=(128,))


def _trained(folder: Path, variant: str) -> MotionModel:
    additions, smoothness_from = VARIANTS[variant]
    plain = paper_small_training()
    plan = replace(
        plain,
        preset=with_additions(plain.preset, additions),
        num_steps=STEPS,
        smoothness_from=smoothness_from,
        time_shifts="amplitude" in additions,
        save_every=10**6,
        save_every_s=1e9,
        figures_every_s=None,
    )
    train_paper(plan, [str(folder / "shard.safetensors")], folder, weights=folder / "trained.safetensors")
    (folder / "checkpoint.safetensors").unlink()
    return load_model(str(folder / "trained.safetensors"))


def _figures(model: MotionModel) -> dict[str, float]:
    """Means over trees."""
    rows = []
    for seed, species in JUDGED:
        sample = make_sample(seed, species)
        voxels, spectrum = voxel_spectrum(sample)
        truth = spectrum.coefficients
        edges = np.stack(voxel_graph(voxels.grid).nonzero(), axis=1)
        guess = model.generate(voxels, wind=sample.wind, seed=0).coefficients
        correlation, rmse = log_amplitude_agreement(guess, truth, sample.mesh.height_m)
        rows.append(
            {
                "log_amplitude_correlation": correlation,
                "log_amplitude_rmse": rmse,
                "centroid_correlation": centroid_correlation(guess, truth),
                "roughness_ratio": roughness(guess, edges) / roughness(truth, edges),
                "size_ratio": float(np.median(amplitude(guess)) / np.median(amplitude(truth))),
            }
        )
    return {name: round(float(np.mean([row[name] for row in rows])), 3) for name in rows[0]}
