"""Every model side by side on the same trees that no training saw: all figures, seconds and megabytes.

Models are those of the weights folder and of DYNAMICTREE_MODELS; trees are those of `dynamictree evaluate --trees 6`,
and the ones that Blender's Sapling add-on baked where DYNAMICTREE_SAMPLES names their folder. A line per tree and model
goes to standard error as soon as it is measured.
"""

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from time import process_time

import numpy as np
import torch

from benchmarks._machine import machine
from dynamictree.devoxelize.length_preserving import length_preserving
from dynamictree.evaluation.figures import TreeReference, figures_of
from dynamictree.evaluation.held_out_trees import Group, HeldOutTree, iter_held_out, iter_sapling
from dynamictree.evaluation.report import generate_for
from dynamictree.evaluation.sapling_file import sapling_files
from dynamictree.models import load_model
from dynamictree.weights import list_weights

TREES = 6
SEED = 0


def run() -> dict[str, object]:
    torch.set_num_threads(1)
    models = {name: load_model(name) for name in list_weights()}
    rows: dict[str, dict[str, list[dict[str, float]]]] = {}
    for group, tree in _trees():
        reference = TreeReference.of(tree)
        for name, model in models.items():
            began = process_time()
            generated = generate_for(tree, model, seed=SEED)
            seconds = process_time() - began
            motion = length_preserving(generated.grid, tree.mesh).apply(generated.coefficients)
            row = {**asdict(figures_of(motion, reference)), "processor_s": seconds, "voxels": len(tree.voxels.grid)}
            rows.setdefault(group, {}).setdefault(name, []).append(row)
            print(
                json.dumps({"group": group, "species": tree.species, "model": name, **row}), file=sys.stderr, flush=True
            )
    return {
        "value": {group: {name: _mean(own) for name, own in of_group.items()} for group, of_group in rows.items()},
        "unit": "see keys",
        "weights_mb": {name: round(path.stat().st_size / 1e6, 1) for name, path in list_weights().items()},
        "sizes": {group: len(next(iter(of_group.values()))) for group, of_group in rows.items()},
        **machine("torch", "numpy"),
    }


def _trees() -> Iterator[tuple[Group, HeldOutTree]]:
    yield from (("unseen-species", tree) for tree in iter_held_out("unseen-species", TREES))
    yield from (("seen-species", tree) for tree in iter_held_out("seen-species", TREES))
    if "DYNAMICTREE_SAMPLES" in os.environ:
        files = sapling_files(Path(os.environ["DYNAMICTREE_SAMPLES"]))
        yield from (("sapling", tree) for tree in iter_sapling(files))


def _mean(rows: list[dict[str, float]]) -> dict[str, float]:
    return {figure: round(float(np.mean([row[figure] for row in rows])), 4) for figure in rows[0]}
