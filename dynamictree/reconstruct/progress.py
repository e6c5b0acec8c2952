"""Progress of a reconstruction as a share of its expected time, and the time taken over all attempts."""

import json
import resource
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from dynamictree.files import atomic_file
from dynamictree.reconstruct.cameras import search_seconds
from dynamictree.reconstruct.options import ReconstructOptions

STAGES = ("photos", "cameras", "depth", "splat", "mesh")
"""Stages of a reconstruction, in order."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a reconstruction."""

    stage: str  # one of `STAGES`, or `cut`
    share: float  # completed share of the stage, [0, 1]
    total: float  # completed share of the total expected time, [0, 1]
    worked_s: float = 0.0  # time worked by this and earlier attempts
    psnr_db: float | None = None  # latest PSNR of held-out photos, during the splat stage


OnProgress = Callable[[Progress], None]
"""Called at least every quarter of a second, except in the mesh stage; an exception in it stops the work."""


class StageReport(Protocol):
    """Callback that reports progress within one stage."""

    def __call__(self, share: float, psnr_db: float | None = None) -> None:
        """Report the completed share, in [0, 1]."""


def expected_seconds(num_photos: int, options: ReconstructOptions) -> dict[str, float]:
    """Estimate each stage's processor seconds; only their ratios matter. Measured: docs/decisions."""
    schedule = options.schedule
    return {
        "photos": 0.1 * num_photos,
        "cameras": sum(search_seconds(num_photos).values()),
        "depth": 1.0 * min(num_photos, options.max_views),
        "splat": schedule.num_steps * (0.01 + 0.1 * (schedule.side_px / 640) ** 2),
        "mesh": 5.0,
    }


class StageClock:
    """Clock that reports progress by expected time, and sums each stage's time over all attempts."""

    def __init__(self, on_progress: OnProgress, expected_s: Mapping[str, float], saved: Path) -> None:
        """Continue with the times of earlier attempts, read from a file."""
        self._on_progress, self._expected_s, self._saved = on_progress, expected_s, saved
        self._total, self._saved_at = 0.0, time.perf_counter()
        earlier = json.loads(saved.read_text()) if saved.exists() else {}
        self.seconds: dict[str, float] = earlier.get("seconds", {})
        self.processor_seconds: dict[str, float] = earlier.get("processor_seconds", {})  # ended child processes too

    @contextmanager
    def stage(self, name: str) -> Iterator[StageReport]:
        """Measure a stage's time; yield the function that reports its progress."""
        save_every_s = 20.0  # time that a killed attempt may lose from the report
        before = sum(self._expected_s[earlier] for earlier in STAGES[: STAGES.index(name)])
        whole = sum(self._expected_s.values())
        start, processor_start = time.perf_counter(), _processor_s()
        seconds, processor_seconds = self.seconds.get(name, 0.0), self.processor_seconds.get(name, 0.0)

        def measure() -> None:
            self.seconds[name] = seconds + time.perf_counter() - start
            self.processor_seconds[name] = processor_seconds + _processor_s() - processor_start

        def report(share: float, psnr_db: float | None = None) -> None:
            measure()
            if time.perf_counter() - self._saved_at > save_every_s:
                self._save()
            self._total = max(self._total, (before + self._expected_s[name] * share) / whole)
            worked_s = sum(self.seconds.values())
            self._on_progress(Progress(stage=name, share=share, total=self._total, worked_s=worked_s, psnr_db=psnr_db))

        try:
            report(0.0)
            yield report
        finally:
            measure()
            self._save()

    def _save(self) -> None:
        if self._saved.parent.exists():
            with atomic_file(self._saved) as stream:
                stream.write(
                    json.dumps({"seconds": self.seconds, "processor_seconds": self.processor_seconds}).encode()
                )
        self._saved_at = time.perf_counter()


def _processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)
