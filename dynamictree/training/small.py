"""Preset `small` from seeds to weights: trees, amplitude network, whitening, denoiser. Each can be gone on with."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import torch.distributed

from dynamictree.diffusion.model import write_network
from dynamictree.diffusion.small import SmallNetwork, SmallPreset
from dynamictree.training.course import Course, Pace, process_rank
from dynamictree.training.examples import cached_example, is_training_seed, prepare_examples
from dynamictree.training.loop import amplitude_rows, amplitude_step, denoising_step, standardise
from dynamictree.training.whitening import NUM_MEASURED, measure, white_example

OnTrainingStep = Callable[[str, int, int, float], None]
"""Called with the part, the step, the steps in all, and the loss."""


@dataclass(frozen=True, kw_only=True)
class SmallTraining:
    """The resolved run."""

    first_seed: int = 1000
    num_seeds: int = 500  # those of species and splits that are for training are used
    preset: SmallPreset = field(default_factory=SmallPreset)
    amplitude: Pace = field(
        default_factory=lambda: Pace(num_steps=3000, learning_rate=2e-3, weight_decay=1e-2, ema_decay=0.995, bf16=True)
    )
    denoiser: Pace = field(default_factory=lambda: Pace(num_steps=1600, learning_rate=2e-3, ema_decay=0.995, bf16=True))
    num_processes: int = 2  # that make trees


def train_small(plan: SmallTraining, folder: Path, *, on_step: OnTrainingStep | None = None) -> SmallNetwork:
    """Train into a folder: `trees/`, a checkpoint a part, `small.safetensors`. What is there is not done again.

    Under `torchrun` every process takes its own batches, and gradients are shared.
    """
    seeds = [seed for seed in range(plan.first_seed, plan.first_seed + plan.num_seeds) if is_training_seed(seed)]
    trees = folder / "trees"
    if process_rank() == 0:
        for done, _ in enumerate(prepare_examples(trees, seeds, num_processes=plan.num_processes)):
            if on_step is not None:
                on_step("trees", done + 1, len(seeds), 0.0)
    _wait_for_all()
    torch.manual_seed(plan.preset.num_frequencies)
    network = SmallNetwork(plan.preset)
    _train_amplitude(network, plan, folder, seeds, on_step)
    _train_denoiser(network, plan, folder, seeds, on_step)
    if process_rank() == 0:
        write_network(network, folder / "small.safetensors")
    return network


def _train_amplitude(
    network: SmallNetwork, plan: SmallTraining, folder: Path, seeds: Sequence[int], on_step: OnTrainingStep | None
) -> None:
    trees = folder / "trees"
    rows = amplitude_rows((cached_example(trees, seed) for seed in seeds), np.random.default_rng(plan.amplitude.seed))
    standardise(network.amplitude, rows)
    course = Course(network.amplitude, plan.amplitude)
    checkpoint = folder / "amplitude.safetensors"
    if checkpoint.exists():
        course.load(checkpoint)
    for step, loss in course.run(lambda rng: amplitude_step(network.amplitude, rows, rng), checkpoint):
        if on_step is not None:
            on_step("amplitude", step, plan.amplitude.num_steps, loss)
    network.amplitude.load_state_dict(course.average.state_dict())
    network.amplitude.requires_grad_(False)


def _train_denoiser(
    network: SmallNetwork, plan: SmallTraining, folder: Path, seeds: Sequence[int], on_step: OnTrainingStep | None
) -> None:
    trees = folder / "trees"
    rng = np.random.default_rng(plan.denoiser.seed)
    measure(network, (cached_example(trees, seed) for seed in rng.permutation(seeds)[:NUM_MEASURED].tolist()), rng)
    world = torch.distributed.get_world_size() if torch.distributed.is_initialized() else 1
    white = [white_example(network, cached_example(trees, seed)) for seed in seeds[process_rank() :: world]]
    course = Course(network.denoiser, plan.denoiser)
    checkpoint = folder / "denoiser.safetensors"
    if checkpoint.exists():
        course.load(checkpoint)
    for step, loss in course.run(lambda rng: denoising_step(network, white, rng), checkpoint):
        if on_step is not None:
            on_step("denoiser", step, plan.denoiser.num_steps, loss)
    network.denoiser.load_state_dict(course.average.state_dict())


def _wait_for_all() -> None:
    if torch.distributed.is_initialized():
        torch.distributed.barrier()
