"""Uploads that were only announced: how long they last, and how much room they reserve for whom."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from jobs.settings import Settings
from jobs.storage import uploads
from service.app import create_app
from service.http.caller import Caller
from service.services import Services
from service.uploads.quota import reserve_space
from tests.service.conftest import refusal
from tests.service.test_assets import send
from tests.service.test_authentication import TREE, app_services, keyed  # noqa: F401
from tests.service.tus import TUS, append, begin

MIB = 1024**2


def test_a_full_disk_has_nothing_promised(settings: Settings) -> None:
    full = settings.model_copy(update={"min_free_bytes": 2**60})
    with TestClient(create_app(full), "http://localhost") as client:
        answer = client.post("/v1/uploads", headers=TUS | {"Upload-Length": "1"})
    assert ", 0 of them promised" in answer.json()["detail"]


def test_announcements_leave_room_for_others(small_disk: Path, settings: Settings) -> None:
    own = {"state_dir": small_disk, "min_free_bytes": 8 * MIB}
    with TestClient(create_app(settings.model_copy(update=own)), "http://localhost") as client:
        for _ in range(22):
            assert client.post("/v1/uploads", headers=TUS | {"Upload-Length": str(14 * MIB)}).status_code == 201
        large = client.post("/v1/uploads", headers=TUS | {"Upload-Length": str(30 * MIB)})
        assert large.status_code == 201, large.text
        assert append(client, large.headers["Location"], 0, bytes(30 * MIB)).status_code == 204
        refusal(client.post("/v1/assets", files={"file": ("tree.obj", bytes(30 * MIB))}), 503, "disk-full")


def test_an_upload_without_a_byte_lasts_minutes(client: TestClient, services: Services) -> None:
    idle, sent = begin(client, 9), begin(client, 9)
    assert append(client, idle, 0, b"").status_code == 204
    assert append(client, sent, 0, b"1").status_code == 204
    now = services.store.clock()
    services.store.clock = lambda: now + services.settings.upload_begin_s + 1
    assert client.head(idle, headers=TUS).status_code == 410
    assert client.head(sent, headers=TUS).status_code == 200


def test_of_too_many_the_oldest_without_a_byte_goes(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MAX_OPEN", 3)
    first, second, third, fourth = (begin(client, 9) for _ in range(4))
    assert client.head(first, headers=TUS).status_code == 410
    for url in (second, third, fourth):
        assert append(client, url, 0, b"1").status_code == 204
    refusal(client.post("/v1/uploads", headers=TUS | {"Upload-Length": "9"}), 429, "quota-exceeded")


def test_parallel_announcements_stay_within_the_quota(app_services: tuple[TestClient, Services]) -> None:  # noqa: F811
    client = keyed(app_services, "ann", bytes=2_000_000)
    with ThreadPoolExecutor(12) as pool:
        answers = pool.map(
            lambda _: client.post("/v1/uploads", headers=TUS | {"Upload-Length": "900000"}).status_code, range(12)
        )
        assert sorted(answers) == [201] * 2 + [429] * 10


def test_a_form_counts_while_it_comes(app_services: tuple[TestClient, Services]) -> None:  # noqa: F811
    services = app_services[1]
    client = keyed(app_services, "ann", bytes=2_000)
    with reserve_space(services.owned_by(Caller(owner="ann", limits={"bytes": 2_000})), 1_500):
        assert send(client, TREE, ("notes.txt", bytes(500))).status_code == 429
    assert send(client, TREE).status_code == 201
