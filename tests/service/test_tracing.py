"""Logs that name their request, and a trace from the client over the request to the worker."""

import json
import logging
from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span

from jobs.logging_setup import JsonLines, log_ids, set_up_logging
from jobs.records import AssetRecord
from jobs.settings import Settings
from jobs.tracing import traced, tracer_provider
from service.app import create_app
from tests.line import Handler, answering
from tests.service.conftest import hold

CLIENT = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"


@pytest.fixture
def collector() -> Iterator[tuple[str, list[Span]]]:
    """What a collector gets, over HTTP as it comes."""
    spans: list[Span] = []

    def receive(_: int, handler: Handler) -> None:
        request = ExportTraceServiceRequest.FromString(handler.body)
        spans.extend(s for r in request.resource_spans for scope in r.scope_spans for s in scope.spans)
        handler.reply(200, b"")

    with answering(receive) as line:
        yield line.url, spans


def test_one_trace_from_the_client_over_the_request_to_the_worker(
    settings: Settings, collector: tuple[str, list[Span]], asset: AssetRecord
) -> None:
    endpoint, spans = collector
    settings = settings.model_copy(update={"otlp_endpoint": endpoint})
    with TestClient(create_app(settings), "http://localhost") as client:
        body = {"type": "voxelize", "asset_id": asset.id}
        payload = client.post("/v1/jobs", json=body, headers={"traceparent": CLIENT}).json()
        lease = hold(client.app.state.services, payload["id"])  # type: ignore[attr-defined]
        client.get(f"/v1/artifacts/{lease.job.id}?key_id=1&expires=1&signature=secret")
    with traced(lease, endpoint):
        pass
    for process in ("api", "worker"):
        tracer_provider(endpoint, process).force_flush()
    assert all(b"secret" not in one.SerializeToString() for one in spans)
    by_name = {one.name: one for one in spans}
    assert "GET /v1/artifacts/{id}" in by_name
    request, attempt = by_name["POST /v1/jobs"], by_name["run voxelize"]
    assert {one.trace_id.hex() for one in (request, attempt)} == {CLIENT.split("-")[1]}
    assert request.parent_span_id.hex() == CLIENT.split("-")[2]
    assert attempt.parent_span_id == request.span_id
    attributes = {attribute.key: attribute.value for attribute in (*request.attributes, *attempt.attributes)}
    assert attributes["http.response.status_code"].int_value == 202
    assert attributes["dynamictree.job_id"].string_value == payload["id"]


def test_a_line_is_an_object_that_names_its_ids() -> None:
    record = logging.makeLogRecord(
        {"name": "x", "levelname": "INFO", "msg": "stage %s", "args": ("a",), "cached": True}
    )
    with log_ids(request_id="r"), log_ids(job_id="j", attempt=2):
        line = json.loads(JsonLines().format(record))
    assert line.pop("time").endswith("+00:00")
    assert line == {
        "level": "INFO",
        "logger": "x",
        "message": "stage a",
        "request_id": "r",
        "job_id": "j",
        "attempt": 2,
        "cached": True,
    }
    assert "job_id" not in json.loads(JsonLines().format(record))


def test_a_traceback_stays_in_its_line() -> None:
    try:
        raise ZeroDivisionError("two\nlines")
    except ZeroDivisionError as error:
        record = logging.makeLogRecord({"msg": "failed", "exc_info": (type(error), error, error.__traceback__)})
    text = JsonLines().format(record)
    assert "\n" not in text
    assert "ZeroDivisionError" in json.loads(text)["traceback"]


def test_the_setting_chooses_the_form(capsys: pytest.CaptureFixture[str], settings: Settings) -> None:
    original = logging.root.handlers[:], logging.root.level
    try:
        set_up_logging(settings.model_copy(update={"log_format": "json"}))
        logging.getLogger("y").warning("one")
        logging.getLogger("httpx").info("a URL with its secrets")
        set_up_logging(settings)
        logging.getLogger("y").warning("two")
    finally:
        logging.root.handlers, level = original[0], original[1]
        logging.root.setLevel(level)
    first, second = capsys.readouterr().err.splitlines()
    assert json.loads(first)["message"] == "one"
    assert second.endswith("WARNING y two")
