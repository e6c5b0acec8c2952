"""`dynamictree train`."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from dynamictree.training.progress import bars

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


def train(
    folder: Annotated[Path, typer.Argument(help="Trees, checkpoints and weights go here; gone on with if there.")],
    preset: Annotated[str, typer.Option(help="Which network: small.")] = "small",
    first_seed: Annotated[int, typer.Option(min=0, max=2**40, help="Seed of the first tree.")] = 1000,
    seeds: Annotated[int, typer.Option(min=4, max=1_000_000, help="Seeds to draw training trees from.")] = 500,
    amplitude_steps: Annotated[int, typer.Option(min=1, max=10_000_000, help="Of the amplitude network.")] = 3000,
    denoiser_steps: Annotated[int, typer.Option(min=1, max=10_000_000, help="Of the diffusion.")] = 1600,
    bf16: Annotated[bool, typer.Option(help="Multiply in bfloat16.")] = True,
    accumulate: Annotated[int, typer.Option(min=1, max=1024, help="Batches a step.")] = 1,
    threads: Annotated[int, typer.Option(min=1, max=256, help="Of each process.")] = 1,
    dry_run: Annotated[bool, typer.Option(help="Print the resolved run and stop.")] = False,
    as_json: AsJson = False,
) -> None:
    """Train a model from seeds alone; under `torchrun` on many processes or machines."""
    import os
    from dataclasses import replace

    import torch
    import torch.distributed

    from dynamictree.errors import InputError
    from dynamictree.training.small import SmallTraining, train_small

    if preset != "small":
        raise InputError(f"there is no training for preset {preset!r}; choose small")
    plain = SmallTraining(first_seed=first_seed, num_seeds=seeds)
    plan = replace(
        plain,
        amplitude=replace(plain.amplitude, num_steps=amplitude_steps, bf16=bf16),
        denoiser=replace(plain.denoiser, num_steps=denoiser_steps, bf16=bf16, accumulate=accumulate),
    )
    resolved = json.dumps(asdict(plan), indent=None if as_json else 2)
    if dry_run:
        typer.echo(resolved)
        return
    torch.set_num_threads(threads)
    if "RANK" in os.environ:
        torch.distributed.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(resolved)
    with bars(quiet=as_json) as on_step:
        train_small(plan, folder, on_step=on_step)
    weights = str(folder / "small.safetensors")
    typer.echo(json.dumps({"weights": weights}) if as_json else weights)
