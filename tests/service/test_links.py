"""Signed links open one file for a while, and nothing else."""

import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from fastapi.testclient import TestClient

from jobs.clients.keys import create_key, revoke_key
from jobs.lifecycle.attempts import succeed
from jobs.records import AssetPart, KeyRecord
from jobs.settings import Settings
from jobs.storage.assets import add_asset
from service.http import authentication
from service.services import Services
from tests.rows import asset_row
from tests.service.conftest import app_of, hold, publish

Opened = tuple[TestClient, KeyRecord, dict[str, str], str]


@pytest.fixture
def opened(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> Iterator[Opened]:
    """A client, a key that may only read, its header, and the path of an artifact."""
    monkeypatch.setattr(authentication, "CACHE_S", 0.2)
    with TestClient(app_of(settings.model_copy(update={"keys": "required"})), "http://localhost") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        _, owners = create_key(services.store, name="w", owner="ann")
        record, key = create_key(services.store, name="r", owner="ann", scopes=("read",))
        part = AssetPart(name="tree.ply", sha256="a" * 64, bytes=10)
        row = asset_row(part, now=services.store.clock(), fingerprint="f" * 64, summary={"num_vertices": 4})
        body = {"type": "voxelize", "asset_id": add_asset(services.store.for_owner("ann"), row)[0].id}
        job = client.post("/v1/jobs", json=body, headers={"Authorization": f"Bearer {owners}"}).json()
        lease = hold(services, job["id"])
        publish(services, lease, "voxelize", "tree.voxels.safetensors", b"12345")
        succeed(services.store, lease)
        headers = {"Authorization": f"Bearer {key}"}
        [artifact] = client.get(f"/v1/jobs/{job['id']}/artifacts", headers=headers).json()["artifacts"]
        yield client, record, headers, artifact["url"]


def _link(opened: Opened, **more: object) -> str:
    client, _, headers, path = opened
    response = client.post("/v1/links", json={"path": path} | more, headers=headers)
    assert response.status_code == 201, response.text
    assert response.headers["cache-control"] == "no-store"
    return str(response.json()["url"])


def test_a_link_opens_its_file_from_any_page(opened: Opened) -> None:
    client, _, _, path = opened
    assert client.get(path).status_code == 401
    link = _link(opened)
    got = client.get(link, headers={"Range": "bytes=1-2", "Origin": "https://gallery.example"})
    assert (got.status_code, got.content) == (206, b"23")
    assert got.headers["access-control-allow-origin"] == "*"
    assert got.headers["cross-origin-resource-policy"] == "cross-origin"
    assert client.head(link).status_code == 200
    assert client.get(f"{link}&filename=tree.bin").status_code == 200


def test_a_link_opens_nothing_else(opened: Opened) -> None:
    client, record, headers, path = opened
    link = _link(opened)
    query = urlsplit(link).query
    other = path[:-1] + ("0" if path[-1] != "0" else "1")
    for wrong in (
        f"{other}?{query}",
        f"/v1/jobs?{query}",
        f"{path}/?{query}",
        link.replace("expires=", "expires=9"),
        link[:-1] + ("0" if link[-1] != "0" else "1"),
        f"{link}&signature=",
        f"{link}&expires=99999999999",
        link.replace(record.id, "0" * 26),
    ):
        answer = client.get(wrong)
        assert answer.status_code == 401, wrong
        assert "access-control-allow-origin" not in answer.headers
    assert client.delete(link).status_code == 401
    assert client.post(f"/v1/links?{query}", json={"path": path}).status_code == 401  # a link makes no links
    assert client.post("/v1/links", json={"path": "/v1/jobs"}, headers=headers).status_code == 404
    assert client.post("/v1/links", json={"path": other}, headers=headers).status_code == 404


def test_a_link_ends_with_its_time_and_with_its_key(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    client, record, _, _ = opened
    services: Services = client.app.state.services  # type: ignore[attr-defined]
    link, now = _link(opened, expires_s=60), services.store.clock()
    monkeypatch.setattr(services.store, "clock", lambda: now + 59)
    assert client.get(link).status_code == 200
    monkeypatch.setattr(services.store, "clock", lambda: now + 61)
    assert client.get(link).status_code == 401
    monkeypatch.setattr(services.store, "clock", lambda: now)
    link = _link(opened)
    assert client.get(link).status_code == 200
    revoke_key(services.store, record.id)
    time.sleep(authentication.CACHE_S + 0.1)
    assert client.get(link).status_code == 401


def test_another_owner_cannot_sign(opened: Opened) -> None:
    client, _, _, path = opened
    services: Services = client.app.state.services  # type: ignore[attr-defined]
    _, key = create_key(services.store, name="other", owner="bob")
    response = client.post("/v1/links", json={"path": path}, headers={"Authorization": f"Bearer {key}"})
    assert response.status_code == 404


def test_without_keys_a_link_is_the_path(client: TestClient, services: Services, tmp_path: Path) -> None:
    part = AssetPart(name="tree.ply", sha256="a" * 64, bytes=10)
    asset = add_asset(services.store, asset_row(part, now=services.store.clock()))[0]
    path = f"/v1/assets/{asset.id}/surface"
    assert client.post("/v1/links", json={"path": path}).json() == {"url": path, "expires_at": None}


def test_every_answer_names_the_version_of_the_api(client: TestClient) -> None:
    newest = (Path(__file__).parents[2] / "docs" / "api-changes.md").read_text().split("## ")[1].split()[0]
    for path in ("/v1/presets", "/v1/jobs/nothing"):
        assert client.get(path).headers["x-api-version"] == newest
    assert "x-api-version" not in client.get("/livez").headers
