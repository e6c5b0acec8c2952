"""The audit log: who, what, when; bounded; and no secret in it."""

import json
import threading
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from jobs.audit import FILES, AuditLog
from jobs.clients.keys import create_key
from jobs.clients.keys import keys as all_keys
from jobs.settings import Settings
from service.app import create_app
from service.local.keys import app as keys


def _events(state_dir: Path) -> list[dict[str, str]]:
    return [json.loads(line) for line in (state_dir / "audit" / "audit.jsonl").read_text().splitlines()]


def test_changes_and_refused_keys_are_written(settings: Settings) -> None:
    settings = settings.model_copy(update={"keys": "required", "outbound_hosts": ("127.0.0.1:1",)})
    with TestClient(create_app(settings), "http://localhost") as client:
        store = client.app.state.services.store  # type: ignore[attr-defined]
        record, key = create_key(store, name="k", owner="ann")
        assert all_keys(store)[0].last_used_at is None
        headers = {"Authorization": f"Bearer {key}"}
        assert client.get("/v1/jobs", headers=headers).status_code == 200
        assert all_keys(store)[0].last_used_at == pytest.approx(store.clock(), abs=60)
        body = {"url": "http://127.0.0.1:1/hook", "events": []}
        response = client.post("/v1/webhook-endpoints", json=body, headers=headers | {"X-Request-Id": "mine"})
        assert response.status_code == 201, response.text
        assert client.delete(f"/v1/webhook-endpoints/{response.json()['id']}", headers=headers).status_code == 204
        assert client.post("/v1/jobs", json={}, headers={"Authorization": "Bearer dt_wrong"}).status_code == 401
    created, deleted, refused = _events(settings.state_dir)
    assert (created["actor"], created["owner"], created["outcome"]) == (record.id, "ann", "201")
    assert (created["action"], created["request_id"]) == ("POST /v1/webhook-endpoints", "mine")
    assert deleted["target"].endswith(response.json()["id"])
    assert (refused["actor"], refused["outcome"]) == ("anyone", "401")
    text = (settings.state_dir / "audit" / "audit.jsonl").read_text()
    assert key not in text
    assert response.json()["secret"] not in text
    assert (settings.state_dir / "audit" / "audit.jsonl").stat().st_mode & 0o777 == 0o600


def test_operators_are_written_too(tmp_path: Path) -> None:
    response = CliRunner().invoke(keys, ["create", "me", "--state-dir", str(tmp_path), "--json", "--expires-days", "1"])
    key = json.loads(response.stdout)
    assert CliRunner().invoke(keys, ["revoke", key["id"], "--state-dir", str(tmp_path)]).exit_code == 0
    listed = json.loads(CliRunner().invoke(keys, ["list", "--state-dir", str(tmp_path), "--json"]).stdout)
    assert listed[0]["last_used_at"] is None
    assert listed[0]["expires_at"] > 0
    assert [(e["action"], e["target"]) for e in _events(tmp_path)] == [
        ("keys create", key["id"]),
        ("keys revoke", key["id"]),
    ]
    assert key["key"] not in str(_events(tmp_path))


def test_the_log_is_bounded_and_no_line_is_torn(tmp_path: Path) -> None:
    log = AuditLog(path=tmp_path / "audit" / "audit.jsonl", max_bytes=40_000)
    threads = [
        threading.Thread(target=lambda who=who: [log.write("x", actor=who, target=str(n)) for n in range(300)])
        for who in ("a", "b", "c", "d")
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    files = sorted((tmp_path / "audit").glob("audit.jsonl*"))
    assert len(files) == FILES
    assert sum(path.stat().st_size for path in files) <= 40_000
    newest = [json.loads(line) for path in files for line in path.read_text().splitlines()]
    assert {"a", "b", "c", "d"} >= {event["actor"] for event in newest}
    assert any(event["target"] == "299" for event in newest)


def test_no_log_where_none_is_wanted(tmp_path: Path) -> None:
    AuditLog(path=tmp_path / "audit.jsonl", max_bytes=0).write("x", actor="a")
    assert not list(tmp_path.iterdir())
