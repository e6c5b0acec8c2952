"""Train the paper's network on a dataset's shards: L_DM, then L_DM + L_LSS; on one process or many (`torchrun`).

The batch of a step consists of pairs of a tree and a frequency. Each pass takes `micro_trees` trees with
`frequencies_per_tree` frequencies each, and a step runs as many passes as the batch needs. Worker processes load trees
from a cache on disk, so that no step voxelizes.
"""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch import Tensor
from torch.utils.data import DataLoader

from dynamictree.diffusion.channels import pack_channels
from dynamictree.diffusion.sampler import linear_schedule, predicted_clean
from dynamictree.models.paper.network import PaperNetwork, PaperPreset
from dynamictree.models.threads import to_device
from dynamictree.models.weights_file import Provenance, write_weights
from lab.dataset.shards import shards_sha256
from lab.paper.examples import ExampleCache, PaperBatch, PaperExample, batch_of
from lab.paper.sample_figures import sample_figures
from lab.training.distributed import num_processes, process_rank, wait_for_all
from lab.training.loss import LocalSmoothness, local_smoothness, prediction_loss
from lab.training.progress import OnStep
from lab.training.trainer import LearningRateSchedule, Trainer, TrainerOptions

NUM_MEASURED = 50  # number of trees for measuring the sizes of frequencies
FIGURES_STEPS = 20  # steps of DDIM


@dataclass(frozen=True, kw_only=True)
class PaperTraining:
    """Resolved run. Learning rate, batch and stages are the paper's (section 6); the optimizer is XCube's."""

    preset: PaperPreset = field(default_factory=PaperPreset)
    num_steps: int = 70_000
    smoothness_from: int = 40_000  # first step with L_LSS
    batch_size: int = 48
    learning_rate: float = 1e-4
    halve_every: int = 20_000
    ema_decay: float = 0.9999
    smoothness: LocalSmoothness = field(default_factory=LocalSmoothness)
    smoothness_weight: float = 1.0  # weight of L_LSS beside L_DM
    micro_trees: int = 1
    frequencies_per_tree: int = 1
    bf16: bool = True
    by_frequency: bool = True  # divide each frequency by its own size; if False, all by one (ablation)
    num_workers: int = 0  # number of processes that load trees
    save_every: int = 500
    save_every_s: float = 60.0
    figures_every_s: float | None = 180.0  # interval at which a tree is generated and its figures logged; None: never
    seed: int = 0

    def options(self) -> TrainerOptions:
        """Return the trainer's options, with the number of passes per step and process that the batch needs."""
        per_pass = self.micro_trees * self.frequencies_per_tree * num_processes()
        return TrainerOptions(
            schedule=LearningRateSchedule(
                num_steps=self.num_steps, learning_rate=self.learning_rate, halve_every=self.halve_every, warmup_steps=1
            ),
            weight_decay=1e-2,
            gradient_clip=0.5,
            ema_decay=self.ema_decay,
            accumulate=max(1, round(self.batch_size / per_pass)),
            bf16=self.bf16,
            save_every=self.save_every,
            save_every_s=self.save_every_s,
            seed=self.seed,
        )


def train_paper(
    plan: PaperTraining,
    shards: Sequence[str],
    folder: Path,
    *,
    weights: Path | None = None,
    device: torch.device | None = None,
    on_step: OnStep | None = None,
    on_figures: Callable[[str], None] | None = None,
) -> PaperNetwork:
    """Train into a folder: `cache/`, `checkpoint.safetensors` to resume from, `figures.jsonl`, and the weights.

    The weights are a moving average. They are written at the end and with every line of figures, so that a stopped run
    also leaves a model: `paper.safetensors` in the folder by default. `on_figures` receives each line of figures.
    """
    weights = weights or folder / "paper.safetensors"
    device = device or torch.device("cpu")
    torch.manual_seed(plan.seed)
    network = PaperNetwork(plan.preset)
    if process_rank() == 0:
        ExampleCache(shards, plan.preset, folder / "cache")
    wait_for_all()
    cache = ExampleCache(shards, plan.preset, folder / "cache")
    network.frequency_sizes.copy_(frequency_sizes(cache, plan))
    trainer = Trainer(network.to(device), plan.options())
    trainer.resume(folder / "checkpoint.safetensors")
    loader = DataLoader(
        cache,
        batch_sampler=_TreeDraws(len(cache), plan, first_pass=trainer.step * trainer.options.accumulate),
        num_workers=plan.num_workers,
        collate_fn=_Collate(plan.preset),
        multiprocessing_context="spawn" if plan.num_workers else None,
    )
    batches = iter(loader)
    schedule = to_device(device, linear_schedule())

    def loss_of(rng: np.random.Generator) -> Float32[Tensor, ""]:
        batch = next(batches)
        shape = (plan.micro_trees, plan.frequencies_per_tree)
        bins = [rng.permutation(plan.preset.num_frequencies)[: shape[1]] for _ in range(shape[0])]
        frequency = torch.from_numpy(np.stack(bins)).to(device)
        batch = to_device(device, batch)
        return paper_loss(
            network,
            batch,
            clean_channels(batch, frequency, network),
            frequency,
            schedule=schedule,
            generator=torch.Generator().manual_seed(int(rng.integers(2**62))),
            smoothness=plan.smoothness if trainer.step >= plan.smoothness_from else None,
            smoothness_weight=plan.smoothness_weight,
        )

    data_sha256, reported_at = shards_sha256(shards), time.monotonic()

    def write(loss: float) -> None:
        card = training_card(weights.stem, plan, trees=len(cache), step=trainer.step, loss=loss)
        provenance = Provenance(step=trainer.step, data_sha256=data_sha256, card=card)
        average = trainer.average
        assert isinstance(average, PaperNetwork)
        write_weights(average, weights, provenance)

    for step, loss in trainer.run(loss_of, folder / "checkpoint.safetensors"):
        if on_step is not None:
            on_step("paper", step, plan.num_steps, loss)
        due = plan.figures_every_s is not None and time.monotonic() - reported_at > plan.figures_every_s
        if process_rank() == 0 and (due or step == plan.num_steps):
            write(loss)
            if due:
                figures = sample_figures(trainer.average, cache[0], num_steps=FIGURES_STEPS)
                line = json.dumps({"step": step, "loss": round(loss, 4), **figures})
                with (folder / "figures.jsonl").open("a") as log:
                    log.write(line + "\n")
                if on_figures is not None:
                    on_figures(line)
            reported_at = time.monotonic()
    return network


def training_card(name: str, plan: PaperTraining, *, trees: int, step: int, loss: float) -> str:
    """Return the facts of a run in Markdown; the quality of its weights is measured by `dynamictree evaluate`."""
    facts = {
        "network": f"the paper's on {plan.preset.resolution}³, {plan.preset.unet.base} channels at its first level",
        "data": f"{trees} trees",
        "steps": f"{step} of batch {plan.batch_size}; with L_LSS from step {plan.smoothness_from}",
        "loss of the last step": f"{loss:.3f}",
    }
    rows = "".join(f"| {name} | {value} |\n" for name, value in facts.items())
    return f"# {name}\n\n| | |\n|---|---|\n{rows}"


def frequency_sizes(cache: ExampleCache, plan: PaperTraining) -> Float32[Tensor, " K"]:
    """Return the RMS of the components at each frequency, by which spectra are divided."""
    trees = [cache[number].spectrum for number in range(min(NUM_MEASURED, len(cache)))]
    power = torch.stack([one.abs().square().mean(dim=(0, 2)) / 2 for one in trees]).mean(dim=0)
    sizes = power.sqrt()
    if plan.by_frequency:
        return sizes
    return sizes[1:].square().mean().sqrt().expand(len(sizes)).contiguous()


def clean_channels(
    batch: PaperBatch, frequency: Int64[Tensor, "B J"], network: PaperNetwork
) -> Float32[Tensor, "V J 6"]:
    """Return each tree's spectrum at its frequencies, normalised to unit size."""
    sample = batch.inputs.grids.levels[network.preset.num_halvings].sample_of_row
    bins = frequency[sample]  # [V, J]
    chosen = batch.spectrum.gather(1, bins[..., None].expand(-1, -1, 3))
    return pack_channels(chosen) / network.frequency_sizes[bins][..., None]


class _TreeDraws(torch.utils.data.Sampler[list[int]]):
    """Sampler of the trees of every pass; a pass depends only on its number, so that a resumed run is identical."""

    def __init__(self, count: int, plan: PaperTraining, first_pass: int) -> None:
        self.count, self.plan, self.first_pass = count, plan, first_pass

    def __iter__(self) -> Iterator[list[int]]:
        number = self.first_pass
        while True:
            rng = np.random.default_rng([self.plan.seed, 1, number, process_rank()])
            yield rng.integers(self.count, size=self.plan.micro_trees).tolist()
            number += 1


class _Collate:
    """Collate function that runs `batch_of` in worker processes, since building neighbour pairs is slow."""

    def __init__(self, preset: PaperPreset) -> None:
        self.preset = preset

    def __call__(self, examples: list[PaperExample]) -> PaperBatch:
        return batch_of(examples, self.preset)


def paper_loss(
    network: PaperNetwork,
    batch: PaperBatch,
    clean: Float32[Tensor, "V J 6"],
    frequency: Int64[Tensor, "B J"],
    *,
    schedule: Float32[Tensor, " L"],
    generator: torch.Generator,
    smoothness: LocalSmoothness | None,
    smoothness_weight: float = 1.0,
) -> Float32[Tensor, ""]:
    """Return L_DM, plus L_LSS of the predicted clean spectrum if `smoothness` is given.

    L_LSS is weighted by ᾱ: at high noise, the clean spectrum computed from ε is an amplified error. Clean spectra are
    normalised to unit size. The paper gives no weight of L_LSS beside L_DM.
    """
    sample = batch.inputs.grids.levels[network.preset.num_halvings].sample_of_row
    step = torch.randint(0, len(schedule), frequency.shape, generator=generator).to(clean.device)
    noise = torch.randn(clean.shape, generator=generator).to(clean.device)
    alpha_bar = schedule[step][sample][..., None]  # [V, J, 1]
    noisy = alpha_bar.sqrt() * clean + (1 - alpha_bar).sqrt() * noise
    predicted = network(noisy, step, frequency, network.condition(batch.inputs), batch.inputs).float()
    loss = prediction_loss(predicted.flatten(0, 1), noise.flatten(0, 1))
    if smoothness is not None:
        implied = alpha_bar * predicted_clean(noisy, predicted, alpha_bar)
        neighbours = batch.neighbours, batch.distances_m
        each = [local_smoothness(one, *neighbours, weights=smoothness) for one in implied.unbind(dim=1)]
        loss = loss + smoothness_weight * torch.stack(each).mean()
    return loss
