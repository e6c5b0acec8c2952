"""A film of a walk around a tree as an asset of photos: what is stored of it, and what is refused."""

from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from dynamictree.formats.film import film_facts
from jobs.storage.assets import read_asset
from service.services import Services
from service.uploads import intake
from tests.formats.films import DEVICE, PLACES, write_film
from tests.service.test_assets import send as send_files


def send(client: TestClient, *paths: Path) -> object:
    return send_files(client, *((path.name, path.read_bytes()) for path in paths))


def stored(services: Services, asset_id: str) -> bytes:
    [part] = read_asset(services.store, asset_id).parts
    return b"".join(services.artifacts.read(part.sha256))


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_film(tmp_path_factory.mktemp("films") / "walk.mp4")


@pytest.mark.parametrize("name", ["walk.mp4", "walk.MOV"])
def test_a_film_becomes_an_asset_of_photos_without_sound_and_place(client, services, tmp_path, name) -> None:
    path = write_film(tmp_path / name)
    sent = path.read_bytes()
    assert any(box in sent for box in PLACES)
    assert DEVICE.encode() in sent
    response = send(client, path)
    assert response.status_code == 201, response.text
    asset = response.json()
    assert (asset["kind"], asset["summary"]) == (
        "photos",
        {"num_photos": 1, "largest_pixels": [320.0, 240.0], "film_s": 3.0, "film_frames": 60},
    )
    assert [part["name"] for part in asset["parts"]] == ["walk.mp4"]
    film_bytes = stored(services, asset["id"])
    assert not any(word in film_bytes for word in (*PLACES, DEVICE.encode(), b"soun"))
    (tmp_path / "kept.mp4").write_bytes(film_bytes)
    assert film_facts(tmp_path / "kept.mp4", "kept").num_frames == 60
    assert send(client, path).json()["id"] == asset["id"]


def test_a_film_is_checked(client: TestClient, walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (more := tmp_path / "more.mp4").write_bytes(walk.read_bytes())
    assert "by itself" in send(client, walk, more).json()["detail"]
    (tmp_path / "broken.mp4").write_bytes(walk.read_bytes()[:2000])
    broken = send(client, tmp_path / "broken.mp4").json()
    assert (broken["code"], "broken.mp4 cannot be read as a film" in broken["detail"]) == ("unsupported-format", True)
    (tmp_path / "text.mp4").write_bytes(b"no film")
    assert send(client, tmp_path / "text.mp4").status_code == 415
    for reason, wrong in (
        ("64 x 64 pixels; at least 240", write_film(tmp_path / "small.mp4", size=(64, 64))),
        ("takes 301 s", write_film(tmp_path / "long.mp4", seconds=301, fps=1)),
        ("2306 pixels; at most 9,437,184", write_film(tmp_path / "large.mp4", size=(4096, 2306), seconds=1, fps=1)),
        ("has 4 frames; at least 8", write_film(tmp_path / "short.mp4", seconds=0.2)),
    ):
        refused = send(client, wrong).json()
        assert (refused["code"], reason in refused["detail"]) == ("invalid-input", True), refused
    monkeypatch.setattr(intake, "MAX_FILM_BYTES", 1000)
    assert send(client, walk).json()["code"] == "payload-too-large"


def test_a_film_with_fewer_frames_than_wanted_photos_makes_no_job(client: TestClient, tmp_path: Path) -> None:
    asset = send(client, write_film(tmp_path / "walk.mp4", seconds=1.5)).json()["id"]
    refused = client.post("/v1/jobs", json={"type": "reconstruct", "asset_id": asset})
    assert (refused.status_code, "30 frames, 40 are" in refused.json()["detail"]) == (422, True)
    wanted = {"type": "reconstruct", "asset_id": asset, "params": {"video_frames": 20}}
    assert client.post("/v1/jobs", json=wanted).status_code in (201, 202)
