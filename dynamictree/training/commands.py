"""`dynamictree train` and `dynamictree evaluate`."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

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
    with _bars(quiet=as_json) as on_step:
        train_small(plan, folder, on_step=on_step)
    weights = str(folder / "small.safetensors")
    typer.echo(json.dumps({"weights": weights}) if as_json else weights)


def evaluate(
    model: Annotated[str, typer.Option(help="Name of a shipped model, or a .safetensors file.")] = "small",
    trees: Annotated[int, typer.Option(min=1, max=10_000, help="Of each group: seen and unseen species.")] = 6,
    known_trees: Annotated[int, typer.Option(min=1, max=10_000, help="Training trees that the baselines know.")] = 40,
    first_seed: Annotated[int, typer.Option(min=0, max=2**40, help="Of the training trees.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Of the generated motions.")] = 0,
    steps: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Of the sampler; the preset's own if not given.")
    ] = None,
    threads: Annotated[int, typer.Option(min=1, max=256, help="Of this process.")] = 2,
    as_json: AsJson = False,
) -> None:
    """Judge a model on trees that no training saw, beside what it must beat: a table, or JSON."""
    import torch

    from dynamictree.training.evaluation import METHODS, evaluate_model

    torch.set_num_threads(threads)
    with _bars(quiet=as_json) as on_step:
        report = evaluate_model(
            model,
            num_trees=trees,
            num_known=known_trees,
            first_seed=first_seed,
            seed=seed,
            num_steps=steps,
            on_step=on_step,
        )
    if as_json:
        typer.echo(json.dumps(report))
        return
    _print_table(report, METHODS)


def _print_table(report: dict[str, Any], methods: dict[str, str]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    for group, rows in report["groups"].items():
        table = Table(title=f"{group}: mean over {report['trees']} trees", title_justify="left")
        table.add_column("figure")
        for method in methods:
            table.add_column(method, justify="right")
        for figure in next(iter(rows.values())):
            table.add_row(figure.replace("_", " "), *(f"{rows[method][figure]:.3f}" for method in methods))
        console.print(table)
    seeds = report["seed_difference"]
    console.print(f"difference between two seeds {seeds['model']:.2f}, between two true winds {seeds['truth']:.2f}")
    verdict = "passes" if report["passes"] else "does not pass"
    console.print(f"{report['model']} {verdict}: {report['rule']}")


def _bars(*, quiet: bool) -> Any:
    """A progress bar a part, on standard error; nothing where a program reads."""
    from contextlib import contextmanager

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    @contextmanager
    def bars() -> Any:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), disable=quiet) as progress:
            tasks: dict[str, Any] = {}

            def on_step(part: str, done: int, total: int, loss: float) -> None:
                if part not in tasks:
                    tasks[part] = progress.add_task(part, total=total)
                described = f"{part} {loss:.3f}" if loss else part
                progress.update(tasks[part], completed=done, description=described)

            yield on_step

    return bars()
