"""OpenTelemetry from request to worker to webhook; off unless `otlp_endpoint` is set. Needs dynamictree[telemetry].

The trace context travels with the job, in its row: the queue carries ids and nothing else.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from jobs.records import Claim

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.trace import Span


@cache
def tracer_provider(endpoint: str, process: str) -> "TracerProvider":
    """One for each process; not to be made before a fork."""
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor

    provider = TracerProvider(resource=Resource.create({"service.name": f"dynamictree-{process}"}))
    sender = OTLPSpanExporter(endpoint=endpoint.rstrip("/") + "/v1/traces")
    provider.add_span_processor(BatchSpanProcessor(sender, schedule_delay_millis=1000))
    return provider


@contextmanager
def traced(claimed: Claim, endpoint: str | None) -> Iterator[None]:
    """Span of an attempt, under that of the request that created its job; none where there is no endpoint."""
    if endpoint is None:
        yield
        return
    from opentelemetry.trace import SpanKind
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    job = claimed.job
    context = TraceContextTextMapPropagator().extract({"traceparent": job.traceparent} if job.traceparent else {})
    ids: dict[str, str | int] = {"job_id": job.id, "attempt": claimed.attempt, "queue": job.queue}
    attributes = {f"dynamictree.{name}": value for name, value in ids.items()}
    tracer = tracer_provider(endpoint, "worker").get_tracer("dynamictree")
    with tracer.start_as_current_span(
        f"run {job.type}", context=context, kind=SpanKind.CONSUMER, attributes=attributes
    ):
        yield


def traceparent(begun: "Span") -> str:
    """W3C traceparent of the current span."""
    context = begun.get_span_context()
    return f"00-{context.trace_id:032x}-{context.span_id:016x}-{context.trace_flags:02x}"
