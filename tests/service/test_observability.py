"""What operators see: /metrics, /v1/ops and the page."""

import re
import sys

import httpx
import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families

from jobs.lifecycle.attempts import succeed
from jobs.records import AssetRecord
from jobs.settings import Settings
from jobs.storage import parser_process
from service.app import create_app
from service.services import Services
from tests.servers import free_port
from tests.service.conftest import hold, publish


@pytest.fixture
def ran(client: TestClient, services: Services, asset: AssetRecord) -> str:
    """One job that a worker ran, and one that waits."""
    ids = [client.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset.id}).json()["id"] for _ in range(2)]
    lease = hold(services, ids[0])
    publish(services, lease, "voxelize", "tree.voxels.safetensors", b"12345")
    succeed(services.store, lease)
    return str(ids[0])


def test_metrics_tell_of_jobs_stages_attempts_and_requests(client: TestClient, ran: str) -> None:
    client.get(f"/v1/jobs/{ran}")
    client.get("/nothing")
    response = client.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain")
    values = {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(response.text)
        for sample in family.samples
    }
    assert values[("dynamictree_jobs", "queued")] == 1
    assert values[("dynamictree_jobs_ended_total", "succeeded")] == 1
    assert values[("dynamictree_queue_jobs", "cpu")] == 1
    assert values[("dynamictree_queue_jobs", "cpu-high")] == 0
    assert values[("dynamictree_queue_age_seconds", "cpu")] >= 0
    assert values[("dynamictree_attempts_total", "started")] == 1
    assert values[("dynamictree_stages_total", "run", "voxelize")] == 1
    assert values[("dynamictree_stage_bytes_total", "voxelize")] == 5
    assert values[("dynamictree_stage_seconds_count", "voxelize")] == 1
    assert values[("dynamictree_stage_seconds_bucket", "3600", "voxelize")] == 1
    assert values[("dynamictree_request_seconds_count", "/v1/jobs/{id}", "GET")] >= 1
    assert values[("dynamictree_answers_total", "404")] >= 1
    assert values[("dynamictree_storage_free_bytes",)] > 0
    assert not any(ran in str(key) or "nothing" in str(key) for key in values)


def test_operations_move_to_an_address_of_their_own(settings: Settings) -> None:
    address = f"127.0.0.1:{free_port()}"
    for _ in range(2):  # it is free again at the end
        app = create_app(settings.model_copy(update={"ops_address": address, "keys": "required"}))
        with TestClient(app, "http://localhost") as client, httpx.Client(base_url=f"http://{address}") as own:
            for path in ("/metrics", "/ops", "/v1/ops"):
                assert client.get(path, headers={"Authorization": "Bearer x"}).status_code in {401, 404}
                assert own.get(path).status_code == 200
            assert client.get("/livez").status_code == own.get("/livez").status_code == 200
            assert 'route="/livez"' in own.get("/metrics").text
            assert own.get("/v1/jobs").status_code == 404


def test_a_service_that_cannot_read_uploads_is_not_ready(client, services: Services, monkeypatch) -> None:
    monkeypatch.setattr(parser_process, "server", parser_process._Server())
    assert client.get("/readyz").json()["reader"] == "absent"
    with monkeypatch.context() as broken:
        broken.setattr(sys, "executable", "/bin/false")
        assert not parser_process.reader_works(services.settings)
        assert client.get("/readyz").json()["reader"] == "unavailable"
    parser_process.reader_works.cache_clear()
    assert client.get("/readyz").json()["reader"] == "ok"
    parser_process.server.end()
    monkeypatch.delattr(parser_process, "parse")  # no file is read per request
    assert client.get("/readyz").json()["reader"] == "ok"


def test_a_trace_comes_back_with_the_answer(client: TestClient) -> None:
    trace = "00-" + "a" * 32 + "-" + "b" * 16 + "-01"
    assert client.get("/livez", headers={"traceparent": trace}).headers["traceparent"] == trace
    assert "traceparent" not in client.get("/livez", headers={"traceparent": "nonsense"}).headers


def test_the_operators_page_loads_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/ops")
    assert page.headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'")
    named = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert named
    for path in named:
        assert client.get(path).status_code == 200
    assert not re.search(r"<script(?![^>]*\bsrc=)|\son\w+=|style=", page.text)
    assert client.get("/ops/index.html").status_code == 422


def test_operations_are_named_without_ids(client: TestClient, ran: str) -> None:
    payload = client.get("/v1/ops").json()
    assert payload["jobs"] == {"queued": 1, "succeeded": 1}
    assert payload["queues"][0]["name"] == "cpu"
    assert payload["attempts"] == {"started": 1}
    assert (payload["workers"], payload["unsent_messages"]) == (0, 1)
    assert ran not in str(payload)
