"""Keys, owners, quotas, rates, origins: who comes in, and to what."""

import threading
import time
from collections.abc import Iterator

import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from jobs.clients.keys import create_key, revoke_key
from jobs.records import Limit, Scope
from jobs.settings import Settings
from jobs.storage.assets import read_asset
from service.app import create_app
from service.http import authentication, slots
from service.http.rate_limit import WRONG_KEYS_PER_MIN
from service.routes import job_events
from service.services import Services
from tests.service.conftest import app_of, hold, publish, refusal
from tests.service.test_assets import PLAIN, send
from tests.service.tus import TUS

TREE = ("tree.obj", PLAIN)


@pytest.fixture
def app_services(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[TestClient, Services]]:
    monkeypatch.setattr(authentication, "CACHE_S", 0.2)
    closed = settings.model_copy(update={"keys": "required", "max_json_bytes": 4096})
    with TestClient(app_of(closed), "http://trees.example", raise_server_exceptions=False) as client:
        yield client, client.app.state.services  # type: ignore[attr-defined]


def keyed(
    opened: tuple[TestClient, Services], owner: str, *, scopes: tuple[Scope, ...] = (), **limits: int
) -> TestClient:
    """A client of the same application that sends a key."""
    named: dict[Limit, int] = dict(limits)  # type: ignore[arg-type]
    chosen = {"scopes": scopes} if scopes else {}
    _, key = create_key(opened[1].store, name="test", owner=owner, limits=named, **chosen)  # type: ignore[arg-type]
    return TestClient(opened[0].app, "http://trees.example", headers={"Authorization": f"Bearer {key}"})


def test_an_address_may_send_few_wrong_keys(app_services: tuple[TestClient, Services]) -> None:
    client, _ = app_services
    codes = [client.get("/v1/jobs", headers={"Authorization": f"Bearer dt_{n}"}).status_code for n in range(40)]
    assert codes == [401] * WRONG_KEYS_PER_MIN + [429] * (40 - WRONG_KEYS_PER_MIN)
    assert "Retry-After" in client.get("/v1/jobs").headers
    assert keyed(app_services, "ann").get("/v1/jobs").status_code == 200


def test_without_a_key_nothing_opens(app_services: tuple[TestClient, Services]) -> None:
    client, _ = app_services
    for headers in ({}, {"Authorization": "Bearer dt_wrong"}, {"Authorization": "Basic eA=="}):
        refused = client.get("/v1/jobs", headers=headers)
        assert (refused.status_code, refused.json()["code"]) == (401, "unauthorized")
        assert refused.headers["WWW-Authenticate"] == "Bearer"
        assert refused.headers["Content-Type"] == "application/problem+json"
    assert client.get("/livez").status_code == 200
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/v1/interact/stream"):
        pass
    assert keyed(app_services, "ann").get("/v1/jobs").status_code == 200


def test_a_revoked_or_expired_key_opens_nothing(app_services: tuple[TestClient, Services]) -> None:
    client, services = app_services
    record, key = create_key(services.store, name="short", expires_s=100)
    headers = {"Authorization": f"Bearer {key}"}
    assert client.get("/v1/usage", headers=headers).json()["owner"] == record.id
    now = services.store.clock()
    services.store.clock = lambda: now + 101
    assert client.get("/v1/usage", headers=headers).status_code == 401
    services.store.clock = lambda: now
    revoke_key(services.store, record.id)
    time.sleep(authentication.CACHE_S + 0.1)  # a replica may know the key for so long
    assert client.get("/v1/usage", headers=headers).status_code == 401


def test_a_key_that_is_revoked_ends_the_events_that_it_follows(app_services, monkeypatch) -> None:
    monkeypatch.setattr(slots, "CHECK_S", 0.05)
    monkeypatch.setattr(job_events, "HEARTBEAT_S", 0.2)
    store = app_services[1].store
    record, key = create_key(store, name="test", owner="ann")
    client = TestClient(app_services[0].app, "http://trees.example", headers={"Authorization": f"Bearer {key}"})
    asset = send(client, TREE).json()["id"]
    job = client.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset}).json()["id"]
    timer = threading.Timer(0.3, lambda: revoke_key(store, record.id))
    timer.start()
    assert client.get(f"/v1/jobs/{job}/events").text.count("event: job") == 1  # the job waits; its events end
    timer.join()


def test_a_key_does_only_what_its_scopes_say(app_services: tuple[TestClient, Services]) -> None:
    reader = keyed(app_services, "ann", scopes=("read",))
    writer = keyed(app_services, "ann", scopes=("read", "write"))
    assert reader.get("/v1/jobs").status_code == 200
    assert send(reader, TREE).json()["code"] == "forbidden"
    assert reader.post("/v1/interact", json={}).json()["code"] == "forbidden"
    high = {"type": "voxelize", "asset_id": send(writer, TREE).json()["id"], "priority": "high"}
    assert writer.post("/v1/jobs", json=high).json()["code"] == "forbidden"
    assert keyed(app_services, "ann").post("/v1/jobs", json=high).status_code == 202


def test_what_others_own_is_not_there(app_services: tuple[TestClient, Services]) -> None:
    ann, bob = keyed(app_services, "ann"), keyed(app_services, "bob")
    services = app_services[1]
    asset = send(ann, TREE).json()
    own = send(bob, TREE)
    assert own.status_code == 201
    assert own.json()["id"] != asset["id"]
    body = {"type": "voxelize", "asset_id": asset["id"]}
    job = ann.post("/v1/jobs", json=body, headers={"Idempotency-Key": "k"}).json()
    lease = hold(services, job["id"])
    publish(services, lease, "voxelize", "tree.spectrum.safetensors", b"no spectrum")
    artifact = ann.get(f"/v1/jobs/{job['id']}/artifacts").json()["artifacts"][0]["id"]
    upload = ann.post("/v1/uploads", headers=TUS | {"Upload-Length": "5"}).headers["Location"]
    hook = ann.post("/v1/webhook-endpoints", json={"url": "https://203.0.113.9/", "events": []})
    assert hook.json()["code"] == "fetch-failed"
    theirs = [
        *((method, f"/v1/assets/{asset['id']}") for method in ("GET", "DELETE")),
        *(("GET", f"/v1/jobs/{job['id']}{part}") for part in ("", "/events", "/artifacts")),
        *(("POST", f"/v1/jobs/{job['id']}/{act}") for act in ("cancel", "retry")),
        *(("GET", f"/v1/{kind}/{artifact}") for kind in ("artifacts", "spectra")),
        *((method, upload) for method in ("GET", "HEAD", "DELETE")),
    ]
    for method, path in theirs:
        assert bob.request(method, path, headers=TUS).status_code == 404, (method, path)
        if method == "GET" and not path.endswith(("/events", artifact)):  # the one would wait for the job's end
            assert ann.request(method, path, headers=TUS).status_code == 200, path
    assert bob.post("/v1/jobs", json=body).status_code == 404
    mine = bob.post("/v1/jobs", json=body | {"asset_id": own.json()["id"]}, headers={"Idempotency-Key": "k"})
    assert mine.status_code == 202
    assert [listed["id"] for listed in bob.get("/v1/jobs").json()["data"]] == [mine.json()["id"]]
    assert bob.get("/v1/usage").json()["active_jobs"] == 1
    assert keyed(app_services, "ann").get(f"/v1/jobs/{job['id']}").status_code == 200


def test_an_owner_has_quotas(app_services: tuple[TestClient, Services]) -> None:
    ann = keyed(app_services, "ann", active_jobs=2, bytes=9_000)
    asset = send(ann, TREE).json()["id"]
    body = {"type": "voxelize", "asset_id": asset}
    first, _ = (ann.post("/v1/jobs", json=body).json() for _ in range(2))
    third = ann.post("/v1/jobs", json=body)
    assert (third.status_code, third.json()["code"]) == (429, "too-many-active-jobs")
    assert third.headers["Retry-After"]
    ann.post(f"/v1/jobs/{first['id']}/cancel")
    assert ann.post("/v1/jobs", json=body).status_code == 202
    refusal(ann.post("/v1/uploads", headers=TUS | {"Upload-Length": "9000"}), 429, "quota-exceeded")
    used = ann.get("/v1/usage").json()
    assert (used["active_jobs"], used["limits"]["bytes"]) == (2, 9_000)
    prepared = read_asset(app_services[1].store, asset).prepared
    assert prepared is not None
    assert used["bytes"] == len(TREE[1]) + prepared.bytes


def test_a_key_has_a_rate_and_its_responses_state_it(app_services: tuple[TestClient, Services]) -> None:
    ann = keyed(app_services, "ann", reads_per_min=3)
    left = []
    for _ in range(3):
        response = ann.get("/v1/limits")
        assert response.headers["RateLimit-Policy"] == '"reads";q=3;w=60'
        left.append(response.headers["RateLimit"].split(";")[1])
    assert left == ["r=2", "r=1", "r=0"]
    over = ann.get("/v1/limits")
    assert (over.status_code, over.json()["code"]) == (429, "rate-limited")
    assert 0 < int(over.headers["Retry-After"]) <= 60
    assert keyed(app_services, "bob").get("/v1/limits").status_code == 200


@pytest.mark.parametrize(
    ("headers", "server", "status"),
    [
        ({}, ("127.0.0.1", 8000), 200),
        ({"Host": "127.0.0.1:8000"}, ("127.0.0.1", 8000), 200),
        ({"Host": "[::1]:8000"}, ("::1", 8000), 200),
        ({"Host": "evil.example"}, ("127.0.0.1", 8000), 403),
        ({"Host": "localhost", "Origin": "https://evil.example"}, ("127.0.0.1", 8000), 403),
        ({"Host": "localhost", "Origin": "null"}, ("127.0.0.1", 8000), 403),
        ({"Host": "localhost", "Origin": "http://localhost"}, ("127.0.0.1", 8000), 200),
        ({}, ("192.168.1.5", 8000), 403),
    ],
)
def test_without_keys_only_this_machine_comes_in(client, headers, server, status) -> None:
    app = client.app

    async def arriving(scope: dict[str, object], receive: object, send: object) -> None:
        await app(scope | {"server": server}, receive, send)  # type: ignore[arg-type, operator]

    response = TestClient(arriving, "http://localhost").get("/v1/presets", headers=headers)  # type: ignore[arg-type]
    assert response.status_code == status, response.text


def test_a_page_of_an_allowed_origin_may_call(settings: Settings) -> None:
    app = create_app(settings.model_copy(update={"cors_origins": ("https://forest.example",)}))
    client = TestClient(app, "http://localhost")
    headers = {"Origin": "https://forest.example", "Access-Control-Request-Method": "PATCH"}
    preflight = client.options("/v1/uploads/x", headers=headers)
    assert preflight.headers["Access-Control-Allow-Origin"] == "https://forest.example"
    response = client.get("/v1/presets", headers={"Origin": "https://forest.example"})
    assert "Upload-Offset" in response.headers["Access-Control-Expose-Headers"]
    assert "Access-Control-Allow-Origin" not in client.get("/livez", headers={"Origin": "https://evil.example"}).headers
    assert client.get("/v1/presets", headers={"Origin": "https://evil.example"}).status_code == 403


def test_a_database_that_is_away_is_reported_as_such(app_services, monkeypatch) -> None:
    client = keyed(app_services, "ann")

    def away(*_: object, **__: object) -> None:
        raise sa.exc.OperationalError("SELECT secret", {}, Exception("away"))

    monkeypatch.setattr(authentication, "find_key", away)
    refused = client.get("/v1/jobs")
    assert (refused.status_code, refused.json()["code"]) == (503, "storage-unavailable")
    assert "Retry-After" in refused.headers


def test_a_websocket_where_there_is_none_is_refused(app_services: tuple[TestClient, Services]) -> None:
    client = keyed(app_services, "ann")
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/v1/jobs"):
        pass


@pytest.mark.parametrize(
    "header", ["Forwarded", "X-Forwarded-For", "X-Forwarded-Proto", "CF-Connecting-IP", "X-Real-IP", "Via"]
)
def test_without_keys_nothing_comes_in_through_a_proxy(client: TestClient, header: str) -> None:
    refused = refusal(client.get("/v1/presets", headers={header: "10.0.0.1"}), 403, "forbidden")
    assert "required" in refused["detail"]


def test_an_owner_has_so_many_streams(app_services: tuple[TestClient, Services]) -> None:
    client, other = keyed(app_services, "ann", streams=2), keyed(app_services, "bob")
    with client.websocket_connect("/v1/interact/stream"), client.websocket_connect("/v1/interact/stream"):
        with client.websocket_connect("/v1/interact/stream") as third:
            assert third.receive_json()["code"] == "rate-limited"
        with other.websocket_connect("/v1/interact/stream") as socket:
            socket.send_json({"type": "ack", "frame": 1})
            assert socket.receive_json()["code"] == "validation-failed"
    with client.websocket_connect("/v1/interact/stream") as socket:
        socket.send_json({"type": "ack", "frame": 1})
        assert socket.receive_json()["code"] == "validation-failed"
