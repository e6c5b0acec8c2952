"""Estimate durations from this service's recent jobs, which are cached for some seconds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import median

from cachetools import TTLCache

from jobs.lifecycle.maintenance import WORKER_LEASES, lease_names
from jobs.lifecycle.statistics import run_seconds, stage_seconds
from jobs.records import JobRecord, StageRecord
from jobs.states import JobState, JobType
from jobs.store import Store

CACHE_S = 10.0
DEFAULT_STAGE_S: dict[JobType, float] = {"reconstruct": 240.0, "voxelize": 1.0, "diffuse": 5.0, "animate": 15.0}
"""Usual duration of each stage of a job on photos on two cores [s]."""


@dataclass(frozen=True)
class Forecast:
    """Queue position, progress and remaining time of a job."""

    queue_position: int | None  # number of jobs before it; None once it has started
    progress: float  # [share of the job's time]
    eta_s: float | None  # time until it ends; None if unknown


@dataclass
class JobDurations:
    """Durations of jobs and stages, cached for `CACHE_S` so that a poll needs no query for them."""

    store: Store
    _recent: TTLCache[tuple[str, str], Sequence[float]] = field(default_factory=lambda: TTLCache(64, CACHE_S))

    def forecast(self, job: JobRecord, position: int | None) -> Forecast:
        """Estimate a job's progress and end, from the speed of the running stage and from this service's history.

        Photos take minutes, so the stages after them have an expected time even without a history. A queued job has
        `position` jobs before it, which all workers share.
        """
        unknown = Forecast(queue_position=position, progress=self._progress(job), eta_s=None)
        if job.terminal or job.state == JobState.CANCELING:
            return unknown
        left = 0.0
        for stage in job.stages:
            of_stage = self._left_s(job, stage)
            if of_stage is None:
                return unknown
            left += of_stage
        if position:
            each = self._remembered("seconds", "any job", partial(run_seconds, self.store))
            if not each:
                return unknown
            [workers] = self._remembered("number", "workers", lambda: [len(lease_names(self.store, WORKER_LEASES))])
            left += median(each) * position / max(workers, 1.0)
        return replace(unknown, eta_s=round(left, 1))

    def _progress(self, job: JobRecord) -> float:
        """Average over the stages; for photos weighted by constant usual times, so that progress never decreases."""
        first, least_of_photos_s = job.stages[0], 20.0  # a cloud takes seconds
        weights = {stage.name: 1.0 for stage in job.stages}
        took = 0.0 if first.started_at is None else (first.finished_at or self.store.clock()) - first.started_at
        if first.name == "reconstruct" and first.progress > 0 and not first.cached and took >= least_of_photos_s:
            weights = DEFAULT_STAGE_S
        whole = sum(weights[stage.name] for stage in job.stages)
        return round(sum(weights[stage.name] * stage.progress for stage in job.stages) / whole, 4)

    def _left_s(self, job: JobRecord, stage: StageRecord) -> float | None:
        """Estimate the time until a stage ends [s], by its speed or by longer recent stages; None without these."""
        if stage.state == "succeeded":
            return 0.0
        least_progress = 0.02  # progress from which a stage's speed predicts its end
        begun = stage.started_at if stage.state == "running" else None
        took = 0.0 if begun is None else self.store.clock() - begun
        if stage.progress >= least_progress:
            return took / stage.progress - took
        recent = self._remembered("seconds", stage.name, partial(stage_seconds, self.store, stage.name))
        if not recent and job.stages[0].name == "reconstruct" and stage.name != "reconstruct":
            recent = [DEFAULT_STAGE_S[stage.name]]
        longer = [seconds for seconds in recent if seconds > took]
        return median(longer) - took if longer else None

    def _remembered(self, what: str, of: str, look: Callable[[], Sequence[float]]) -> Sequence[float]:
        values = self._recent.get((what, of))
        if values is None:
            values = self._recent[what, of] = look()
        return values
