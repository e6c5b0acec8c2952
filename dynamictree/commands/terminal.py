"""Output of commands: progress on standard error, results on standard output."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Protocol

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


class Report(Protocol):
    """Callback for the progress of a long command."""

    def __call__(self, stage: str, done: float, note: str = "") -> None:
        """Report a stage's name, its completed share in [0, 1], and a note beside its bar."""


@contextmanager
def progress(*, quiet: bool) -> Iterator[Report]:
    """Show one progress bar per stage; nothing if `quiet`, for output that a program reads."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskID,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        *(TextColumn("{task.description:<12}"), BarColumn(), TaskProgressColumn()),
        *(TimeElapsedColumn(), TimeRemainingColumn(), TextColumn("{task.fields[note]}")),
    )
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as display:
        bars: dict[str, TaskID] = {}

        def report(stage: str, done: float, note: str = "") -> None:
            if stage not in bars:
                for earlier in bars.values():
                    display.update(earlier, completed=1.0)
                bars[stage] = display.add_task(stage, total=1.0, note=note)
            display.update(bars[stage], completed=done, note=note)

        yield report


def show_result(facts: dict[str, Any], *, as_json: bool) -> None:
    """Print the result as aligned text or as JSON."""
    if as_json:
        typer.echo(json.dumps(facts))
        return
    for name, value in facts.items():
        typer.echo(f"{name}: {', '.join(map(str, value)) if isinstance(value, list) else value}")
