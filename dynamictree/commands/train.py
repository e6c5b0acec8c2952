"""`dynamictree train`."""

import json
from dataclasses import asdict, replace
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynamictree.terminal import AsJson
from dynamictree.training.progress import OnStep, bars

if TYPE_CHECKING:
    from dynamictree.models.paper.train import PaperRun
    from dynamictree.models.small.train import SmallTraining

PRESETS = ("small", "paper")


def train(
    folder: Annotated[Path, typer.Argument(help="Checkpoints and weights go here; gone on with if there.")],
    dataset: Annotated[
        list[Path],
        typer.Option(help="Folder of shards, as `dynamictree dataset generate` bakes them; of several, in turn."),
    ],
    preset: Annotated[str, typer.Option(help="Which network: small or paper.")] = "small",
    foliage_trees: Annotated[int, typer.Option(min=1, max=10_000_000, help="Trees of the foliage network.")] = 800,
    foliage_steps: Annotated[int, typer.Option(min=1, max=10_000_000, help="Steps of the foliage network.")] = 5000,
    amplitude_trees: Annotated[int, typer.Option(min=1, max=10_000_000, help="Trees of the amplitude network.")] = 1200,
    amplitude_steps: Annotated[int, typer.Option(min=1, max=10_000_000, help="Steps of the amplitude network.")] = 3000,
    denoiser_trees: Annotated[int, typer.Option(min=1, max=10_000_000, help="Trees of the diffusion.")] = 160,
    denoiser_steps: Annotated[int, typer.Option(min=1, max=10_000_000, help="Steps of the diffusion.")] = 1600,
    foliage_from: Annotated[
        str | None, typer.Option(help="Weights (.safetensors) whose foliage network is gone on from.")
    ] = None,
    denoiser_from: Annotated[
        str | None, typer.Option(help="Weights (.safetensors) whose denoiser the diffusion goes on from.")
    ] = None,
    paper_steps: Annotated[int, typer.Option(min=1, max=10_000_000, help="Of preset paper.")] = 70_000,
    smoothness_from: Annotated[
        int, typer.Option(min=0, max=10_000_000, help="Paper's step from which L_LSS counts.")
    ] = 40_000,
    width: Annotated[
        int, typer.Option(min=8, max=1024, help="Channels of the paper's U-Net at its first level.")
    ] = 128,
    resolution: Annotated[
        int, typer.Option(min=8, max=128, help="Of the paper's spectra; its condition's is 4 times.")
    ] = 128,
    batch: Annotated[int, typer.Option(min=1, max=4096, help="Trees and frequencies a step of preset paper.")] = 48,
    micro_batch: Annotated[int, typer.Option(min=1, max=4096, help="Of them, those at a time in each process.")] = 1,
    bf16: Annotated[bool, typer.Option(help="Multiply in bfloat16.")] = True,
    accumulate: Annotated[int, typer.Option(min=1, max=1024, help="Batches a step.")] = 1,
    threads: Annotated[int, typer.Option(min=1, max=256, help="Of each process.")] = 1,
    dry_run: Annotated[bool, typer.Option(help="Print the resolved run and stop.")] = False,
    as_json: AsJson = False,
) -> None:
    """Train a model from a dataset's shards; under `torchrun` on many processes or machines."""
    import os

    import torch
    import torch.distributed

    from dynamictree.errors import InputError

    if preset not in PRESETS:
        raise InputError(f"there is no training for preset {preset!r}; choose {' or '.join(PRESETS)}")
    if preset == "paper":
        plan: SmallTraining | PaperRun = _paper_run(
            paper_steps, smoothness_from, batch, width=width, resolution=resolution, micro_batch=micro_batch, bf16=bf16
        )
    else:
        steps = foliage_steps, amplitude_steps, denoiser_steps
        trees = foliage_trees, amplitude_trees, denoiser_trees
        plan = _small_training(steps, trees, (foliage_from, denoiser_from), bf16=bf16, accumulate=accumulate)
    resolved = json.dumps(asdict(plan), indent=None if as_json else 2)
    if dry_run:
        typer.echo(resolved)
        return
    shards = _in_turn([sorted(map(str, folder.glob("*.safetensors"))) for folder in dataset])
    if not shards:
        raise InputError(f"there are no shards in {dataset[0]}; bake some with `dynamictree dataset generate`")
    torch.set_num_threads(threads)
    if "RANK" in os.environ:
        torch.distributed.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(resolved)
    with bars(quiet=as_json) as on_step:
        _train(plan, shards, folder, on_step)
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()
    weights = str(folder / f"{preset}.safetensors")
    typer.echo(json.dumps({"weights": weights}) if as_json else weights)


def _in_turn(folders: list[list[str]]) -> list[str]:
    """The first of each, the second of each, and so on to the end of the longest."""
    return [shard for row in zip_longest(*folders) for shard in row if shard is not None]


def _small_training(
    steps: tuple[int, int, int],
    trees: tuple[int, int, int],
    started_from: tuple[str | None, str | None],
    *,
    bf16: bool,
    accumulate: int,
) -> "SmallTraining":
    from dynamictree.models.small.train import SmallTraining

    plain = SmallTraining()
    return replace(
        plain,
        foliage_trees=trees[0],
        amplitude_trees=trees[1],
        denoiser_trees=trees[2],
        foliage_from=started_from[0],
        denoiser_from=started_from[1],
        foliage=replace(plain.foliage, num_steps=steps[0], bf16=bf16),
        amplitude=replace(plain.amplitude, num_steps=steps[1], bf16=bf16),
        denoiser=replace(plain.denoiser, num_steps=steps[2], bf16=bf16, accumulate=accumulate),
    )


def _paper_run(
    steps: int, smoothness_from: int, batch: int, *, width: int, resolution: int, micro_batch: int, bf16: bool
) -> "PaperRun":
    from dynamictree.models.paper.network import PaperTraining, paper_preset
    from dynamictree.models.paper.train import PaperRun

    return PaperRun(
        preset=paper_preset(width),
        training=PaperTraining(num_iterations=steps, smoothness_from=smoothness_from, batch_size=batch),
        resolution=resolution,
        micro_batch=micro_batch,
        bf16=bf16,
    )


def _train(plan: "SmallTraining | PaperRun", shards: list[str], folder: Path, on_step: OnStep) -> None:
    from dynamictree.models.paper.train import PaperRun, train_paper
    from dynamictree.models.small.train import train_small

    if isinstance(plan, PaperRun):
        train_paper(plan, shards, folder, on_step=on_step)
    else:
        train_small(plan, shards, folder, on_step=on_step)
