"""Estimate durations from this service's own recent jobs, remembered for seconds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import median

from cachetools import TTLCache

from jobs.lifecycle.maintenance import WORKER_LEASES, living
from jobs.lifecycle.statistics import run_seconds, stage_seconds
from jobs.records import JobRecord, StageRecord
from jobs.states import JobState, JobType
from jobs.store import Store

REMEMBERED_S = 10.0
OF_PHOTOS_S: dict[JobType, float] = {"reconstruct": 240.0, "voxelize": 1.0, "diffuse": 5.0, "animate": 15.0}
"""Seconds that the stages of a job on photos usually take on two cores."""


@dataclass(frozen=True)
class Forecast:
    """Where a job stands."""

    queue_position: int | None  # jobs before it; None once it has begun
    progress: float  # share of its time
    eta_s: float | None  # until it ends; None where that is not known


@dataclass
class JobDurations:
    """Durations, remembered for `REMEMBERED_S`, so that a poll costs no query for them."""

    store: Store
    _recent: TTLCache[tuple[str, str], Sequence[float]] = field(default_factory=lambda: TTLCache(64, REMEMBERED_S))

    def forecast(self, job: JobRecord, position: int | None) -> Forecast:
        """Where a job stands; its end by the pace of the stage that runs and by this service's history.

        After photos, which take minutes, later stages have an expected time even without a history. A job that waits
        has `position` others before it, which the workers share.
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
            [workers] = self._remembered("number", "workers", lambda: [len(living(self.store, WORKER_LEASES))])
            left += median(each) * position / max(workers, 1.0)
        return replace(unknown, eta_s=round(left, 1))

    def _progress(self, job: JobRecord) -> float:
        """Mean over the stages; of photos weighed by usual times, which a job keeps, so that it never goes back."""
        first, least_of_photos_s = job.stages[0], 20.0  # a cloud takes seconds
        weights = {stage.name: 1.0 for stage in job.stages}
        took = 0.0 if first.started_at is None else (first.finished_at or self.store.clock()) - first.started_at
        if first.name == "reconstruct" and first.progress > 0 and not first.cached and took >= least_of_photos_s:
            weights = OF_PHOTOS_S
        whole = sum(weights[stage.name] for stage in job.stages)
        return round(sum(weights[stage.name] * stage.progress for stage in job.stages) / whole, 4)

    def _left_s(self, job: JobRecord, stage: StageRecord) -> float | None:
        """Seconds until a stage ends: by its pace, or as those that took longer than it has; None where none did."""
        if stage.state == "succeeded":
            return 0.0
        least_progress = 0.02  # before the pace of a stage tells when it ends
        begun = stage.started_at if stage.state == "running" else None
        took = 0.0 if begun is None else self.store.clock() - begun
        if stage.progress >= least_progress:
            return took / stage.progress - took
        recent = self._remembered("seconds", stage.name, partial(stage_seconds, self.store, stage.name))
        if not recent and job.stages[0].name == "reconstruct" and stage.name != "reconstruct":
            recent = [OF_PHOTOS_S[stage.name]]
        longer = [seconds for seconds in recent if seconds > took]
        return median(longer) - took if longer else None

    def _remembered(self, what: str, of: str, look: Callable[[], Sequence[float]]) -> Sequence[float]:
        values = self._recent.get((what, of))
        if values is None:
            values = self._recent[what, of] = look()
        return values
