"""Stages of a reconstruction: how far each is, and how much time it took."""

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

STAGES = {"photos": 0.03, "cameras": 0.27, "depth": 0.15, "splat": 0.5, "mesh": 0.05}
"""Stages in order, and their usual shares of the total time."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """How far a reconstruction is."""

    stage: str  # one of `STAGES`
    share: float  # of the stage that is done, in [0, 1]
    total: float  # of everything that is done, in [0, 1]
    psnr_db: float | None = None  # of the held-out photos so far, while the splat is learned


OnProgress = Callable[[Progress], None]
"""Called at least every quarter of a second except while the mesh is made; an exception in it stops the work."""


class StageReport(Protocol):
    """Reports the share of one stage."""

    def __call__(self, share: float, psnr_db: float | None = None) -> None:
        """Report a share in [0, 1]."""


def ignore_progress(progress: Progress) -> None:
    """Report to nobody."""


class StageClock:
    """Reports progress by stage and adds up the time that each takes."""

    def __init__(self, on_progress: OnProgress) -> None:
        self._on_progress = on_progress
        self._total = 0.0
        self.seconds: dict[str, float] = {}
        self.processor_seconds: dict[str, float] = {}  # of all cores, ended child processes included

    @contextmanager
    def stage(self, name: str) -> Iterator[StageReport]:
        """Measure a stage, and get the function that reports its progress."""
        names = list(STAGES)
        before = sum(STAGES[earlier] for earlier in names[: names.index(name)])

        def report(share: float, psnr_db: float | None = None) -> None:
            self._total = max(self._total, min(before + STAGES[name] * share, 1.0))
            self._on_progress(Progress(stage=name, share=share, total=self._total, psnr_db=psnr_db))

        start, processor_start = time.perf_counter(), _processor_s()
        report(0.0)
        yield report
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
        self.processor_seconds[name] = self.processor_seconds.get(name, 0.0) + _processor_s() - processor_start


def _processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)
