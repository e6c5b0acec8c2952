"""`dynamictree train`: train a model on a dataset's shards."""

import json
from dataclasses import asdict, replace
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynamictree.commands.terminal import AsJson

if TYPE_CHECKING:
    import torch

    from lab.paper.train import PaperTraining
    from lab.small.train import SmallTraining
    from lab.training.progress import OnStep

PRESETS = ("small", "paper")
DEVICES = ("auto", "cpu", "cuda")
MAX = 10_000_000


def train(
    folder: Annotated[Path, typer.Argument(help="Folder for checkpoints and weights; a stopped run continues.")],
    dataset: Annotated[
        list[Path], typer.Option(help="Folder of shards from `dynamictree dataset generate`; several are interleaved.")
    ],
    preset: Annotated[str, typer.Option(help=f"Network: {', '.join(PRESETS)}.")] = "small",
    foliage_trees: Annotated[int, typer.Option(min=0, max=MAX, help="Small: trees for the foliage network.")] = 800,
    foliage_steps: Annotated[
        int, typer.Option(min=0, max=MAX, help="Small: steps of the foliage network; 0 keeps --start-from's.")
    ] = 5000,
    amplitude_trees: Annotated[
        int, typer.Option(min=1, max=MAX, help="Small: trees for the amplitude network.")
    ] = 1200,
    amplitude_steps: Annotated[int, typer.Option(min=1, max=MAX, help="Small: steps of the amplitude network.")] = 3000,
    denoiser_trees: Annotated[int, typer.Option(min=1, max=MAX, help="Small: trees for the denoiser.")] = 160,
    denoiser_steps: Annotated[
        int, typer.Option(min=0, max=MAX, help="Small: steps of the denoiser; 0 keeps --start-from's.")
    ] = 1600,
    start_from: Annotated[str | None, typer.Option(help="Small: weights file to start from.")] = None,
    accumulate: Annotated[int, typer.Option(min=1, max=1024, help="Small: batches per step of the denoiser.")] = 1,
    steps: Annotated[int | None, typer.Option(min=1, max=MAX, help="Paper: steps; by default the preset's.")] = None,
    smoothness_from: Annotated[
        int | None, typer.Option(min=0, max=MAX, help="Paper: first step with L_LSS; by default the preset's.")
    ] = None,
    smoothness_weight: Annotated[
        float | None, typer.Option(min=0.0, max=1000.0, help="Paper: weight of L_LSS relative to L_DM; by default 1.")
    ] = None,
    width: Annotated[
        int | None, typer.Option(min=8, max=1024, help="Paper: channels of the U-Net's first level; by default 128.")
    ] = None,
    resolution: Annotated[
        int | None,
        typer.Option(min=8, max=128, help="Paper: resolution of the spectrum, by default 128 (condition: 4 times)."),
    ] = None,
    batch: Annotated[
        int | None, typer.Option(min=1, max=4096, help="Paper: pairs of tree and frequency per step.")
    ] = None,
    micro_trees: Annotated[int, typer.Option(min=1, max=4096, help="Paper: trees per pass and process.")] = 1,
    frequencies: Annotated[
        int | None, typer.Option(min=1, max=16, help="Paper: frequencies of each of these trees per pass.")
    ] = None,
    workers: Annotated[int, typer.Option(min=0, max=256, help="Paper: processes that load trees.")] = 0,
    bf16: Annotated[bool | None, typer.Option(help="Multiply in bfloat16; by default the preset's.")] = None,
    device: Annotated[str, typer.Option(help=f"{', '.join(DEVICES)}; small uses the CPU.")] = "auto",
    threads: Annotated[int, typer.Option(min=1, max=256, help="Threads per process.")] = 1,
    dry_run: Annotated[bool, typer.Option(help="Print the resolved options and stop.")] = False,
    as_json: AsJson = False,
) -> None:
    """Train a model from a dataset's shards; under `torchrun` on many processes or machines."""
    from dynamictree.errors import InputError

    if preset not in PRESETS:
        raise InputError(f"there is no training for preset {preset!r}; choose {' or '.join(PRESETS)}")
    if device not in DEVICES:
        raise InputError(f"there is no device {device!r}; choose {', '.join(DEVICES)}")
    if start_from is None and 0 in (foliage_steps, denoiser_steps):
        raise InputError("0 steps keep a network; give it with --start-from, or ask for steps")
    if foliage_trees == 0 and foliage_steps > 0:
        raise InputError("the foliage network has steps and no trees; raise --foliage-trees, or give --foliage-steps 0")
    plan: SmallTraining | PaperTraining
    if preset == "small":
        numbers = foliage_steps, amplitude_steps, denoiser_steps
        trees = foliage_trees, amplitude_trees, denoiser_trees
        plan = _small_training(numbers, trees, start_from, bf16=bf16 is not False, accumulate=accumulate)
    else:
        plan = _paper_training(
            width,
            resolution,
            num_steps=steps,
            smoothness_from=smoothness_from,
            smoothness_weight=smoothness_weight,
            batch_size=batch,
            frequencies_per_tree=frequencies,
            micro_trees=micro_trees,
            num_workers=workers,
            bf16=bf16,
        )
    resolved = json.dumps(asdict(plan), indent=None if as_json else 2)
    if dry_run:
        typer.echo(resolved)
        return
    rows = zip_longest(*(sorted(map(str, folder.glob("*.safetensors"))) for folder in dataset))
    shards = [shard for row in rows for shard in row if shard is not None]  # folders in turn
    if not shards:
        raise InputError(f"there are no shards in {dataset[0]}; bake some with `dynamictree dataset generate`")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(resolved)
    weights = str(_run(plan, preset, shards, folder, device=device, threads=threads, quiet=as_json))
    typer.echo(json.dumps({"weights": weights}) if as_json else weights)


def _small_training(
    steps: tuple[int, int, int], trees: tuple[int, int, int], start_from: str | None, *, bf16: bool, accumulate: int
) -> "SmallTraining":
    from lab.small.train import SmallTraining

    plain = SmallTraining()
    return replace(
        plain,
        foliage_trees=trees[0],
        amplitude_trees=trees[1],
        denoiser_trees=trees[2],
        start_from=start_from,
        foliage=replace(plain.foliage.with_steps(steps[0]), bf16=bf16),
        amplitude=replace(plain.amplitude.with_steps(steps[1]), bf16=bf16),
        denoiser=replace(plain.denoiser.with_steps(steps[2]), bf16=bf16, accumulate=accumulate),
    )


def _paper_training(width: int | None, resolution: int | None, **changes: int | float | None) -> "PaperTraining":
    from dynamictree.models.paper.network import paper_preset
    from lab.paper.train import PaperTraining

    chosen = {name: value for name, value in changes.items() if value is not None}
    return replace(PaperTraining(preset=paper_preset(width or 128, resolution or 128)), **chosen)  # type: ignore[arg-type]


def _run(
    plan: "SmallTraining | PaperTraining",
    preset: str,
    shards: list[str],
    folder: Path,
    *,
    device: str,
    threads: int,
    quiet: bool,
) -> Path:
    """Train and return the path of the weights file."""
    import torch

    from lab.small.train import SmallTraining
    from lab.training.distributed import training_processes
    from lab.training.progress import bars

    torch.set_num_threads(threads)
    on_cpu = isinstance(plan, SmallTraining) or device == "cpu" or (device == "auto" and not torch.cuda.is_available())
    weights = folder / f"{preset}.safetensors"
    with training_processes(torch.device("cpu" if on_cpu else "cuda")) as own_device, bars(quiet=quiet) as on_step:
        _train(plan, shards, folder, weights, own_device, on_step)
    return weights


def _train(
    plan: "SmallTraining | PaperTraining",
    shards: list[str],
    folder: Path,
    weights: Path,
    device: "torch.device",
    on_step: "OnStep",
) -> None:
    from lab.paper.train import PaperTraining, train_paper
    from lab.small.train import train_small

    if isinstance(plan, PaperTraining):
        train_paper(
            plan,
            shards,
            folder,
            weights=weights,
            device=device,
            on_step=on_step,
            on_figures=partial(typer.echo, err=True),
        )
    else:
        train_small(plan, shards, folder, on_step=on_step)
