"""Progress of a command with several stages: bars in a terminal, lines in a log, JSON events for a program."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from dynamictree.commands.terminal import progress
from dynamictree.reconstruct.progress import Progress

Report = Callable[[Progress], None]


@contextmanager
def stage_progress(*, as_json: bool) -> Iterator[Report]:
    """Report on standard error: bars in a terminal, else a line at each quarter of a stage, or JSON events."""
    line_at = 0.25  # share of a stage between two lines of a log
    event_every_s = 1.0
    if as_json:
        yield _Lines(_event, every_s=event_every_s)
    elif not sys.stderr.isatty():
        yield _Lines(_line, every_share=line_at)
    else:
        with progress(quiet=False) as bars:
            yield lambda one: bars(one.stage, one.share, "" if one.psnr_db is None else f"{one.psnr_db:.1f} dB")


class _Lines:
    """Log one line at the beginning and end of each stage, and a few in between."""

    def __init__(
        self, text_of: Callable[[Progress, float | None], str], *, every_s: float = 0.0, every_share: float = 0.0
    ) -> None:
        self._text_of, self._every_s, self._every_share = text_of, every_s, every_share
        self._stage, self._start, self._written_at, self._written_share = "", 0.0, 0.0, 0.0

    def __call__(self, progress: Progress) -> None:
        now = time.monotonic()
        begins = progress.stage != self._stage
        if begins:
            self._stage, self._start = progress.stage, now
        elif not self._due(progress.share, now):
            return
        self._written_at, self._written_share = now, progress.share
        share, least_share = progress.share, 0.05  # share of a stage before its end can be estimated
        eta_s = (now - self._start) * (1 - share) / share if share >= least_share else None
        typer.echo(self._text_of(progress, eta_s), err=True)

    def _due(self, share: float, now: float) -> bool:
        if share == 1:
            return self._written_share < 1
        return now - self._written_at >= self._every_s and share - self._written_share >= self._every_share


def _event(progress: Progress, eta_s: float | None) -> str:
    fields = {"stage": progress.stage, "share": round(progress.share, 4), "total": round(progress.total, 4)}
    psnr = None if progress.psnr_db is None else round(progress.psnr_db, 2)
    eta = None if eta_s is None else round(eta_s, 1)
    return json.dumps({"event": "progress", **fields, "stage_eta_s": eta, "psnr_db": psnr})


def _line(progress: Progress, eta_s: float | None) -> str:
    notes = [f"{progress.stage}: {100 * progress.share:.0f} %"]
    if progress.psnr_db is not None:
        notes.append(f"{progress.psnr_db:.1f} dB in photos not learned from")
    if eta_s is not None and progress.share < 1:
        notes.append(f"about {eta_s:.0f} s left")
    return ", ".join(notes)
