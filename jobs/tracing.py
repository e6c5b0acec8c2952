"""OpenTelemetry from request to worker to webhook; off unless `otlp_endpoint` is set. Needs dynamictree[telemetry].

The trace context travels with the job, in its row: the queue carries ids and nothing else.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.trace import Span, SpanKind, Tracer


def tracer(endpoint: str, process: str) -> "Tracer":
    """Spans of this process, sent to a collector in batches."""
    return tracer_provider(endpoint, process).get_tracer("dynamictree")


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
def span(
    spans: "Tracer", name: str, *, parent: str | None, kind: "SpanKind", **attributes: str | int
) -> Iterator["Span"]:
    """One span, under the one that a traceparent names."""
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    context = TraceContextTextMapPropagator().extract({"traceparent": parent} if parent else {})
    span_attributes = {f"dynamictree.{key}": value for key, value in attributes.items()}
    with spans.start_as_current_span(name, context=context, kind=kind, attributes=span_attributes) as begun:
        yield begun


def traceparent(begun: "Span") -> str:
    """W3C traceparent of the current span."""
    context = begun.get_span_context()
    return f"00-{context.trace_id:032x}-{context.span_id:016x}-{context.trace_flags:02x}"
