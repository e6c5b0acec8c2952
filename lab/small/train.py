"""Train preset `small` on a dataset's shards: foliage network, amplitude network, whitening, denoiser.

Each part has its own checkpoint and can be resumed; the amplitude network's rows are beside them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from safetensors.torch import load_file
from torch import Tensor

from dynamictree.models.small.network import SmallNetwork, SmallPreset
from dynamictree.models.weights_file import Provenance, write_weights
from lab.dataset.shards import shards_sha256
from lab.small.examples import example_of, gust_pair, iter_training
from lab.small.spread import measure_field, measure_spread
from lab.small.train_foliage import STANDARDISED_ON, foliage_examples, foliage_step, standardise_foliage
from lab.small.training_steps import (
    AmplitudeRows,
    amplitude_rows,
    amplitude_step,
    denoising_step,
    read_rows,
    standardise,
    write_rows,
)
from lab.small.whitening import MEASURED, NUM_MEASURED, measure, white_example
from lab.training.checkpoints import load_part
from lab.training.distributed import num_processes, process_rank, wait_for_all
from lab.training.progress import OnStep
from lab.training.trainer import LearningRateSchedule, Trainer, TrainerOptions

TREES_PER_FILE = 25
FINE_TUNING_FACTOR = 0.5
"""Factor on the learning rate if a network starts from weights (docs/decisions/diffusion.md)."""


@dataclass(frozen=True, kw_only=True)
class SmallTraining:
    """Settings of a training run. Each part uses different trees, so that none is measured on its training data."""

    foliage_trees: int = 800
    amplitude_trees: int = 1200
    denoiser_trees: int = 160
    preset: SmallPreset = field(default_factory=SmallPreset)
    foliage: TrainerOptions = field(
        default_factory=lambda: TrainerOptions(
            schedule=LearningRateSchedule(num_steps=5000, learning_rate=3e-3, cooldown_steps=500),
            bf16=True,
            save_every=100,
            seed=1,
        )
    )
    amplitude: TrainerOptions = field(
        default_factory=lambda: TrainerOptions(
            schedule=LearningRateSchedule(num_steps=3000, learning_rate=2e-3),
            weight_decay=1e-2,
            ema_decay=0.995,
            bf16=True,
        )
    )
    denoiser: TrainerOptions = field(
        default_factory=lambda: TrainerOptions(
            schedule=LearningRateSchedule(num_steps=1600, learning_rate=2e-3), ema_decay=0.995, bf16=True
        )
    )
    start_from: str | None = None  # weights to start from; with 0 steps, a network and its scales stay


def train_small(
    plan: SmallTraining, shards: Sequence[str], folder: Path, *, on_step: OnStep = lambda part, done, total, loss: None
) -> SmallNetwork:
    """Train into a folder: `rows/`, a checkpoint per part, `small.safetensors`. Existing parts are not trained again.

    Under `torchrun`, every process draws its own batches, and gradients are averaged.
    """
    torch.manual_seed(plan.preset.num_frequencies)
    network = SmallNetwork(plan.preset)
    _train_foliage(network, plan, shards, folder / "foliage.safetensors", on_step)
    rows = _rows(network, plan, shards, folder / "rows", on_step)
    _train_amplitude(network, plan, rows, folder / "amplitude.safetensors", on_step)
    _train_denoiser(network, plan, shards, folder / "denoiser.safetensors", on_step)
    if process_rank() == 0:
        write_weights(
            network,
            folder / "small.safetensors",
            Provenance(step=plan.denoiser.schedule.num_steps or None, data_sha256=shards_sha256(shards)),
        )
    return network


def _train_foliage(
    network: SmallNetwork, plan: SmallTraining, shards: Sequence[str], checkpoint: Path, on_step: OnStep
) -> None:
    if plan.start_from is not None:
        load_part(network.foliage, load_file(plan.start_from), "foliage")
    trainer = Trainer(network.foliage, plan.foliage)
    trainer.resume(checkpoint)
    if not trainer.finished:
        measured = foliage_examples(iter_training(shards, first=0, count=plan.foliage_trees))
        trees = list(islice(measured, STANDARDISED_ON + trainer.step))
        if trainer.step == 0 and plan.start_from is None:
            standardise_foliage(network.foliage, trees)
            trainer.average.load_state_dict(network.foliage.state_dict())

        def loss_of(rng: np.random.Generator) -> Float32[Tensor, ""]:
            trees.extend(islice(measured, 1))  # one more per step, so that no step waits for their measurement
            return foliage_step(network.foliage, trees, rng)

        for step, loss in trainer.run(loss_of, checkpoint):
            on_step("foliage", step, plan.foliage.schedule.num_steps, loss)
    network.foliage.load_state_dict(trainer.average.state_dict())
    network.foliage.requires_grad_(False)


def _rows(
    network: SmallNetwork, plan: SmallTraining, shards: Sequence[str], folder: Path, on_step: OnStep
) -> AmplitudeRows:
    """Return the training rows of the amplitude network; the first process writes them, all read them."""
    paths = [folder / f"{first:06d}.safetensors" for first in range(0, plan.amplitude_trees, TREES_PER_FILE)]
    if process_rank() == 0:
        folder.mkdir(parents=True, exist_ok=True)
        if not all(path.exists() for path in paths):
            trees = iter_training(shards, first=plan.foliage_trees, count=plan.amplitude_trees)
            for path in paths:
                some = list(islice(trees, TREES_PER_FILE))
                if not path.exists():
                    rng = np.random.default_rng([plan.amplitude.seed, int(path.stem)])
                    write_rows(amplitude_rows(network.foliage, map(example_of, some), rng), path)
                on_step("trees", int(path.stem) + len(some), plan.amplitude_trees, 0.0)
    wait_for_all()
    return read_rows(paths)


def _train_amplitude(
    network: SmallNetwork, plan: SmallTraining, rows: AmplitudeRows, checkpoint: Path, on_step: OnStep
) -> None:
    options = plan.amplitude
    if plan.start_from is not None:
        load_part(network.amplitude, load_file(plan.start_from), "amplitude")
        options = options.with_slower_rate(FINE_TUNING_FACTOR)
    else:
        standardise(network.amplitude, rows)
    trainer = Trainer(network.amplitude, options)
    trainer.resume(checkpoint)
    for step, loss in trainer.run(lambda rng: amplitude_step(network.amplitude, rows, rng), checkpoint):
        on_step("amplitude", step, plan.amplitude.schedule.num_steps, loss)
    network.amplitude.load_state_dict(trainer.average.state_dict())
    network.amplitude.eval().requires_grad_(False)


def _train_denoiser(
    network: SmallNetwork, plan: SmallTraining, shards: Sequence[str], checkpoint: Path, on_step: OnStep
) -> None:
    if plan.start_from is not None and plan.denoiser.schedule.num_steps == 0:
        before = load_file(plan.start_from)
        load_part(network.denoiser, before, "denoiser")
        for name in MEASURED:
            network.get_buffer(name).copy_(before[name])
        return
    first = plan.foliage_trees + plan.amplitude_trees
    num_measured = min(NUM_MEASURED, plan.denoiser_trees)
    measured = map(example_of, iter_training(shards, first=first, count=num_measured))
    deviation = measure(network, measured)
    options = plan.denoiser
    if plan.start_from is not None:
        load_part(network.denoiser, load_file(plan.start_from), "denoiser")
        options = options.with_slower_rate(FINE_TUNING_FACTOR)
    trainer = Trainer(network.denoiser, options)
    trainer.resume(checkpoint)
    if not trainer.finished:
        trees = iter_training(shards, first=first, count=plan.denoiser_trees)
        own = islice(trees, process_rank(), None, num_processes())
        white = [white_example(network, example_of(tree), deviation) for tree in own]
        for step, loss in trainer.run(lambda rng: denoising_step(network, white, rng), checkpoint):
            on_step("denoiser", step, plan.denoiser.schedule.num_steps, loss)
    network.denoiser.load_state_dict(trainer.average.state_dict())
    trees = iter_training(shards, first=first, count=plan.denoiser_trees)
    measure_spread(network, map(gust_pair, trees))
    measure_field(network, iter_training(shards, first=first, count=num_measured), plan.denoiser.seed)
