"""A span for every request by OpenTelemetry's instrumentation of FastAPI; the job that it creates continues the trace.

It names a span by its route and follows OpenTelemetry's conventions for HTTP servers. Imported only where
`otlp_endpoint` is set.
"""

import os
from typing import Any

from fastapi import FastAPI
from opentelemetry.instrumentation.fastapi import FastAPIInstrumentor
from opentelemetry.trace import Span

from jobs.tracing import traceparent, tracer_provider
from service.http.request_headers import TRACEPARENT


def trace_requests(app: FastAPI, endpoint: str) -> None:
    """Send a span of each request to the collector at `endpoint`."""
    # the stable names of attributes (http.request.method), not those from before 2023 (http.method)
    os.environ.setdefault("OTEL_SEMCONV_STABILITY_OPT_IN", "http")
    FastAPIInstrumentor.instrument_app(
        app,
        tracer_provider=tracer_provider(endpoint, "api"),
        server_request_hook=_begin,
        exclude_spans=["receive", "send"],
    )


def _begin(span: Span, scope: dict[str, Any]) -> None:
    scope[TRACEPARENT] = traceparent(span)
    # a link's signature is a credential, and the library's list of words to hide lacks it
    span.set_attribute("url.query", "")
