"""Every model and the simple baselines on the same trees that no training saw: all figures, seconds and megabytes.

Models are those of the weights folder and of DYNAMICTREE_MODELS; trees and baselines are those of
`dynamictree evaluate --trees 6 --training-trees 12`, and the trees that Blender's Sapling add-on baked where
DYNAMICTREE_SAMPLES names their folder. A line per tree and method goes to standard error as soon as it is measured.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from time import process_time

import numpy as np
import torch
from jaxtyping import Complex64

from benchmarks._machine import machine
from dynamictree.devoxelize.length_preserving import length_preserving
from dynamictree.models import MotionModel, load_model
from dynamictree.weights import list_weights
from lab.evaluation.baselines import fit_by_height, nearest_tree
from lab.evaluation.figures import TreeReference, figures_of
from lab.evaluation.held_out_trees import Group, HeldOutTree, iter_held_out, iter_sapling
from lab.evaluation.report import generate_for, mean_of, training_trees
from lab.evaluation.sapling_file import sapling_files

TREES, TRAINING_TREES, FIRST_SEED = 6, 12, 1000
SEED = 0
Method = Callable[[HeldOutTree], Complex64[np.ndarray, "N K 3"]]


def run() -> dict[str, object]:
    torch.set_num_threads(1)
    methods = _methods()
    rows: dict[str, dict[str, list[dict[str, float]]]] = {}
    for group, tree in _trees():
        reference = TreeReference.of(tree)
        for name, method in methods.items():
            began = process_time()
            motion = method(tree)
            seconds = process_time() - began
            row = {**asdict(figures_of(motion, reference)), "processor_s": seconds, "voxels": len(tree.voxels.grid)}
            rows.setdefault(group, {}).setdefault(name, []).append(row)
            line = {"group": group, "species": tree.species, "method": name, **row}
            print(json.dumps(line), file=sys.stderr, flush=True)
    return {
        "value": {
            group: {name: {figure: round(one, 4) for figure, one in mean_of(own).items()} for name, own in each.items()}
            for group, each in rows.items()
        },
        "unit": "see keys",
        "weights_mb": {name: round(path.stat().st_size / 1e6, 1) for name, path in list_weights().items()},
        "sizes": {group: len(next(iter(of_group.values()))) for group, of_group in rows.items()},
        **machine("torch", "numpy"),
    }


def _methods() -> dict[str, Method]:
    """What gives the motion of a tree's vertices [m], by name."""
    trees = training_trees(TRAINING_TREES, FIRST_SEED, lambda part, done, total, loss: None)
    by_height = fit_by_height(trees)

    def mean(tree: HeldOutTree) -> Complex64[np.ndarray, "N K 3"]:
        spectrum = by_height.spectrum(tree.voxels.grid, tree.wind, np.random.default_rng([SEED, 1]))
        return length_preserving(tree.voxels.grid, tree.mesh).apply(spectrum)

    def nearest(tree: HeldOutTree) -> Complex64[np.ndarray, "N K 3"]:
        return length_preserving(tree.voxels.grid, tree.mesh).apply(nearest_tree(tree.voxels, tree.wind, trees))

    models = {name: _generates(load_model(name)) for name in list_weights()}
    return {**models, "by-height mean": mean, "nearest tree": nearest}


def _generates(model: MotionModel) -> Method:
    def motion(tree: HeldOutTree) -> Complex64[np.ndarray, "N K 3"]:
        generated = generate_for(tree, model, seed=SEED)
        return length_preserving(generated.grid, tree.mesh).apply(generated.coefficients)

    return motion


def _trees() -> Iterator[tuple[Group, HeldOutTree]]:
    yield from (("unseen-species", tree) for tree in iter_held_out("unseen-species", TREES))
    yield from (("seen-species", tree) for tree in iter_held_out("seen-species", TREES))
    if "DYNAMICTREE_SAMPLES" in os.environ:
        files = sapling_files(Path(os.environ["DYNAMICTREE_SAMPLES"]))
        yield from (("sapling", tree) for tree in iter_sapling(files))
