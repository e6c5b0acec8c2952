"""Estimate durations and sizes from medians of this service's own recent jobs, cached for seconds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from statistics import median

from cachetools import TTLCache

from jobs.lifecycle.maintenance import WORKER_LEASES, living
from jobs.lifecycle.statistics import run_seconds, stage_bytes, stage_seconds
from jobs.records import JobRecord
from jobs.states import JobState, JobType
from jobs.store import Store

REMEMBERED_S = 10.0


@dataclass
class JobDurations:
    """Medians, remembered for `REMEMBERED_S`, so that a poll costs no query for them."""

    store: Store
    _medians: TTLCache[tuple[str, str], float] = field(default_factory=lambda: TTLCache(64, REMEMBERED_S))
    _unknown: set[tuple[str, str]] | None = None

    def for_one_answer(self) -> "JobDurations":
        """These medians, which look no second time for what has no history."""
        return JobDurations(self.store, self._medians, set())

    def stage_seconds(self, stages: Sequence[JobType]) -> float | None:
        """What stages take together [s]; None where one never ran here."""
        return self._sum("seconds", stages, stage_seconds)

    def stage_bytes(self, stages: Sequence[JobType]) -> int | None:
        """What stages make together [bytes]; None where one never ran here."""
        total = self._sum("bytes", stages, stage_bytes)
        return None if total is None else round(total)

    def eta_s(self, job: JobRecord, position: int | None) -> float | None:
        """Seconds until a job ends, as far as progress and history tell; never guessed.

        A job that waits has `position` others before it, which the workers share. It changes only with the job, its
        place in the queue and the history, so that an unchanged job stays unchanged.
        """
        if job.terminal or job.state == JobState.CANCELING:
            return None
        left = 0.0
        for stage in job.stages:
            if stage.state in {"queued", "running"}:
                seconds = self.stage_seconds((stage.name,))
                if seconds is None:
                    return None
                left += seconds * (1 - stage.progress)
        if position:
            each = self._median("seconds", "any job", partial(run_seconds, self.store))
            if each is None:
                return None
            workers = self._median("number", "workers", lambda: [float(len(living(self.store, WORKER_LEASES)))])
            left += each * position / max(workers or 1.0, 1.0)
        return round(left, 1)

    def _sum(
        self, what: str, stages: Sequence[JobType], look: Callable[[Store, JobType], Sequence[float]]
    ) -> float | None:
        medians = [self._median(what, stage, partial(look, self.store, stage)) for stage in stages]
        return None if None in medians else sum(value for value in medians if value is not None)

    def _median(self, what: str, of: str, look: Callable[[], Sequence[float]]) -> float | None:
        value = self._medians.get((what, of))
        if value is not None or (self._unknown is not None and (what, of) in self._unknown):
            return value
        if samples := look():
            value = self._medians[what, of] = float(median(samples))
        elif self._unknown is not None:
            self._unknown.add((what, of))
        return value
