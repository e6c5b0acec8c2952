"""The audit channel: who, what, when; and no secret in it."""

import logging

import pytest
from fastapi.testclient import TestClient
from uvicorn import Config

from jobs.clients.keys import create_key
from jobs.clients.keys import keys as all_keys
from jobs.logging_setup import set_up_logging
from jobs.settings import Settings
from service.app import create_app


def test_changes_and_refused_keys_are_logged(settings: Settings, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "dynamictree.audit")
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
    created, deleted, refused = (vars(line) for line in caplog.records if line.name == "dynamictree.audit")
    assert (created["actor"], created["owner"], created["outcome"]) == (record.id, "ann", 201)
    assert created["message"].startswith("POST /v1/webhook-endpoints: ")
    assert created["request_id"] == "mine"
    assert deleted["target"].endswith(response.json()["id"])
    assert (refused["actor"], refused["outcome"]) == ("anyone", 401)
    assert key not in caplog.text
    assert response.json()["secret"] not in caplog.text


@pytest.fixture
def own_loggers(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("", "uvicorn", "uvicorn.access"):
        logger = logging.getLogger(name)
        for attribute, value in (("handlers", []), ("level", logger.level), ("propagate", logger.propagate)):
            monkeypatch.setattr(logger, attribute, value)


@pytest.mark.usefixtures("own_loggers")
def test_the_access_log_tells_no_signature(settings: Settings, capsys: pytest.CaptureFixture[str]) -> None:
    Config("service.app:serving_app")  # sets up uvicorn's own loggers, as its start does
    set_up_logging(settings)
    line = ("127.0.0.1:9", "GET", "/v1/artifacts/A?key_id=K&expires=9&signature=abcdef0123", "1.1", 200)
    logging.getLogger("uvicorn.access").info('%s - "%s %s HTTP/%s" %d', *line)
    logged = capsys.readouterr().err
    assert "/v1/artifacts/A?key_id=K&expires=9&signature=" in logged
    assert "abcdef" not in logged


@pytest.mark.usefixtures("own_loggers")
def test_an_access_log_that_is_switched_off_stays_so(settings: Settings) -> None:
    Config("service.app:serving_app", access_log=False)
    set_up_logging(settings)
    assert not logging.getLogger("uvicorn.access").hasHandlers()  # what uvicorn asks before each line
