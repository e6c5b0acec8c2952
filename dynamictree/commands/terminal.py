"""Output of commands: progress on standard error, results on standard output."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]

Report = Callable[[str, float], None]
"""What a long command tells of a stage: its name and the share done in [0, 1]."""


@contextmanager
def progress(*, quiet: bool) -> Iterator[Report]:
    """Show one progress bar per stage; nothing if `quiet`, for output that a program reads."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<12}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as progress_bar:
        bars: dict[str, TaskID] = {}

        def report(stage: str, done: float) -> None:
            if stage not in bars:
                bars[stage] = progress_bar.add_task(stage, total=1.0)
            progress_bar.update(bars[stage], completed=done)

        yield report


def tell(facts: dict[str, Any], *, as_json: bool) -> None:
    """Print the result as aligned text or as JSON."""
    if as_json:
        typer.echo(json.dumps(facts))
        return
    for name, value in facts.items():
        typer.echo(f"{name}: {', '.join(map(str, value)) if isinstance(value, list) else value}")
