"""`dynamictree evaluate`."""

import json
from typing import Annotated, Any

import typer

from dynamictree.training.progress import bars

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


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
    with bars(quiet=as_json) as on_step:
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
