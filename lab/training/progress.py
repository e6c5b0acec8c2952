"""Progress of long commands: one bar per part, on standard error."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

OnStep = Callable[[str, int, int, float], None]
"""Called with the stage, the steps done, the total number of steps, and a loss (0 if there is none)."""


@contextmanager
def bars(*, quiet: bool) -> Iterator[OnStep]:
    """Context manager that shows one progress bar per part; none if `quiet`, for programs that read the output."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as progress:
        tasks: dict[str, TaskID] = {}

        def on_step(part: str, done: int, total: int, loss: float) -> None:
            if part not in tasks:
                tasks[part] = progress.add_task(part, total=total)
            described = f"{part} {loss:.3f}" if loss else part
            progress.update(tasks[part], completed=done, description=described)

        yield on_step
