"""/metrics: metrics in Prometheus' format.

Counts of jobs come from the store, so every replica reports the same; requests and memory are per process.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from fastapi import APIRouter, Response
from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric

from jobs.database.counters import SECONDS, tallies
from jobs.lifecycle.statistics import Census, census
from jobs.states import JobState, queues_of
from jobs.storage.artifacts import ArtifactStore
from jobs.store import Store
from service.http.middleware import ANSWERS, REQUEST_SECONDS
from service.http.routing import refusals
from service.services import OwnedDep

router = APIRouter(tags=["health"])


@router.get(
    "/metrics",
    response_class=Response,
    responses=refusals("storage-unavailable")
    | {200: {"description": "Prometheus' text format", "content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def get_metrics(owned: OwnedDep) -> Response:
    """Return counts, ages and durations for Prometheus."""
    registry = CollectorRegistry()
    store_metrics = StoreMetrics(
        owned.store,
        owned.services.artifacts,
        tuple(queue for base in owned.services.settings.job_queues for queue in queues_of(base)),
    )
    for own in (REQUEST_SECONDS, ANSWERS, store_metrics):
        registry.register(own)
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)


@dataclass(frozen=True)
class StoreMetrics:
    """Metrics read from the store at each scrape."""

    store: Store
    artifacts: ArtifactStore
    queues: tuple[str, ...]  # always reported: an autoscaler treats a missing one as a failure

    def collect(self) -> Iterator[Metric]:
        """Collect every metric family."""
        with self.store.reading() as connection:
            counted, now = tallies(connection), census(connection, self.store.clock())
        yield from store_gauges(now, self.queues)
        yield from _counters(counted)
        free = self.artifacts.free_bytes()
        if free is not None:
            yield _gauge("storage_free_bytes", "Room left in the storage", {(): free})


def store_gauges(now: Census, queue_names: tuple[str, ...]) -> Iterator[Metric]:
    """Yield the gauges of the service's current state."""
    states: dict[tuple[str, ...], float] = {(str(state),): now.jobs.get(state, 0) for state in JobState}
    yield _gauge("jobs", "Jobs with a record, by state", states, ["state"])
    none: dict[tuple[str, ...], float] = {(name,): 0.0 for name in queue_names}
    lengths = none | {(queue.name,): queue.jobs for queue in now.queues}
    yield _gauge("queue_jobs", "Jobs that wait", lengths, ["queue"])
    unfinished = none | {(queue.name,): queue.jobs + queue.running for queue in now.queues}
    yield _gauge("queue_unfinished_jobs", "Jobs that wait or run: workers that have work", unfinished, ["queue"])
    ages = none | {(queue.name,): queue.oldest_s for queue in now.queues}
    yield _gauge("queue_age_seconds", "How long the oldest job waits", ages, ["queue"])
    yield _gauge("outbox_messages", "Messages not yet sent", {(): now.unsent_messages})
    yield _gauge("workers", "Workers that are there", {(): now.workers})
    yield _gauge("housekeeper", "Whether a housekeeper acts", {(): now.has_housekeeper})
    yield _gauge("stored_bytes", "Bytes stored", {(): now.stored_bytes})


def _counters(counted: dict[str, dict[str, float]]) -> Iterator[Metric]:
    yield _counter("jobs_ended", "Jobs that ended, by state", counted.get("jobs", {}), ["state"])
    yield _counter(
        "attempts", "Attempts started, lost with their worker, or handed back", counted.get("attempts", {}), ["how"]
    )
    yield _counter(
        "stages", "Stages done, really run or taken from the cache", counted.get("stages", {}), ["stage", "how"]
    )
    yield _counter("stage_bytes", "Bytes that stages made", counted.get("stage_bytes", {}), ["stage"])
    family = HistogramMetricFamily(
        "dynamictree_stage_seconds", "How long stages took that were really run", labels=["stage"]
    )
    classes = counted.get("stage_seconds_bucket", {})
    for stage, total in counted.get("stage_seconds_sum", {}).items():
        reached, buckets = 0.0, []
        for bound in (*SECONDS, float("inf")):
            reached += classes.get(f"{stage}:{bound:g}", 0.0)
            buckets.append(("+Inf" if bound == float("inf") else f"{bound:g}", reached))
        family.add_metric([stage], buckets=buckets, sum_value=total)
    yield family


def _gauge(name: str, what: str, values: Mapping[tuple[str, ...], float], labels: list[str] | None = None) -> Metric:
    family = GaugeMetricFamily(f"dynamictree_{name}", what, labels=labels or [])
    for key, value in values.items():
        family.add_metric(list(key), float(value))
    return family


def _counter(name: str, what: str, values: Mapping[str, float], labels: list[str]) -> Metric:
    family = CounterMetricFamily(f"dynamictree_{name}", what, labels=labels)
    for label, value in values.items():
        family.add_metric(label.split(":"), value)
    return family
