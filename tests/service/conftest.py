from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from jobs.lifecycle.attempts import claim, publish_stage, start_stage
from jobs.records import AssetPart, AssetRecord, Claim, OutputFile
from jobs.settings import Settings
from jobs.states import JobType
from jobs.storage.assets import add_asset
from service.app import create_app
from service.services import Services
from tests.rows import asset_row, stored_part


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    # starlette opens its WebSockets as testserver, whatever the base
    return Settings(state_dir=tmp_path / "state", parser_cpu_s=60, hosts=("testserver",))


_APPS: dict[str, FastAPI] = {}


def app_of(settings: Settings) -> FastAPI:
    """The application, with no memory; one for all tests whose settings differ in their folder alone.

    To build it takes longer than to start it.
    """
    key = settings.model_dump_json(exclude={"state_dir"})
    app = _APPS[key] = _APPS.get(key) or create_app(settings)
    app.state.settings, app.middleware_stack = settings, None
    return app


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(app_of(settings), "http://localhost", raise_server_exceptions=False) as opened:
        yield opened


@pytest.fixture
def services(client: TestClient) -> Services:
    services: Services = client.app.state.services  # type: ignore[attr-defined]
    return services


def change_services(client: TestClient, **changes: object) -> None:
    """Replace some of the services of a running application."""
    state = client.app.state  # type: ignore[attr-defined]
    state.services = replace(state.services, **changes)


@pytest.fixture
def asset(services: Services) -> AssetRecord:
    part = AssetPart(name="tree.ply", sha256="a" * 64, bytes=10)
    row = asset_row(part, now=services.store.clock(), fingerprint="f" * 64, summary={"num_vertices": 4})
    return add_asset(services.store, row)[0]


def hold(services: Services, job_id: str) -> Claim:
    """Claim a job as a worker does."""
    lease = claim(services.store, job_id, 1, owner="test", lease_s=60)
    assert lease is not None
    return lease


def publish(services: Services, lease: Claim, stage: JobType, name: str, content: bytes) -> None:
    """Publish one file of a stage as a worker does."""
    path = services.settings.state_dir / name
    path.write_bytes(content)
    part = stored_part(services.artifacts, path)
    file = OutputFile(name=name, media_type="application/octet-stream", sha256=part.sha256, bytes=part.bytes)
    start_stage(services.store, lease, stage)
    publish_stage(services.store, lease, stage, (file,), key=part.sha256, cached=False, retention_s=5000)


def refusal(response, status: int, code: str) -> dict:
    """The problem that a response is."""
    assert response.headers["Content-Type"] == "application/problem+json"
    problem = response.json()
    assert (response.status_code, problem["code"]) == (status, code), problem
    return problem
