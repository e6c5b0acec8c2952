"""The tus protocol at /v1/uploads, request by request. A real client and broken connections: test_uploads_served.py."""

import asyncio
import hashlib
from collections.abc import AsyncIterator

import pytest
from fastapi.testclient import TestClient

from jobs.storage.uploads import upload
from service.http.caller import ANYONE
from service.http.problems import ProblemError
from service.services import Services
from service.uploads import append as append_module
from service.uploads.append import append as append_body
from tests.service.conftest import refusal
from tests.service.test_assets import MTL, OBJ, left_behind
from tests.service.tus import BYTES, TUS, append, begin, metadata, whole


def test_the_protocol_is_announced(client: TestClient) -> None:
    response = client.options("/v1/uploads")
    assert response.status_code == 204
    assert response.headers["Tus-Version"] == "1.0.0"
    extensions = {"creation", "creation-with-upload", "expiration", "termination"}
    assert set(response.headers["Tus-Extension"].split(",")) == extensions
    assert int(response.headers["Tus-Max-Size"]) == 4 * 1024**3


def test_pieces_become_an_upload_and_uploads_an_asset(client: TestClient, services: Services) -> None:
    url = begin(client, len(OBJ), filename="tree.obj")
    for start in range(0, len(OBJ), 40):
        assert client.head(url, headers=TUS).headers["Upload-Offset"] == str(start)
        sent = append(client, url, start, OBJ[start : start + 40])
        assert (sent.status_code, sent.headers["Upload-Offset"]) == (204, str(min(start + 40, len(OBJ))))
        assert sent.headers["Upload-Expires"].endswith("GMT")
    stands = client.head(url, headers=TUS)
    assert stands.headers["Cache-Control"] == "no-store"
    assert stands.headers["Upload-Length"] == str(len(OBJ))
    assert stands.headers["Upload-Metadata"] == metadata(filename="tree.obj")
    ids = [url.rpartition("/")[2], whole(client, MTL, filename="tree.mtl")]
    assert client.get(url).json()["state"] == "received"
    created = client.post("/v1/assets", json={"upload_ids": ids, "unit_m": 2})
    assert created.status_code == 201, created.text
    assert created.json()["summary"]["extent_m"] == [2.0, 2.0, 4.0]
    assert [part["name"] for part in created.json()["parts"]] == ["tree.obj", "tree.mtl"]
    assert created.json()["parts"][0]["sha256"] == hashlib.sha256(OBJ).hexdigest()
    upload = client.get(url).json()
    assert (upload["state"], upload["asset_id"]) == ("ready", created.json()["id"])
    again = client.post("/v1/assets", json={"upload_ids": ids, "unit_m": 2})
    assert (again.status_code, again.json()["id"]) == (200, created.json()["id"])
    files = [("file", ("tree.obj", OBJ)), ("file", ("tree.mtl", MTL))]
    assert client.post("/v1/assets", files=files, data={"unit_m": "2"}).json()["id"] == created.json()["id"]
    assert left_behind(services) == []
    assert services.upload_parts.size(ids[0]) == 0


def test_an_upload_that_is_no_tree_says_so(client: TestClient) -> None:
    id = whole(client, b"hello world\n", filename="tree.obj", asset="auto")
    response = client.get(f"/v1/uploads/{id}", headers={"Prefer": "wait=30"}).json()
    seen = (response["state"], response["asset_id"], response["error"]["code"])
    assert seen == ("failed", None, "unsupported-format")
    assert client.post("/v1/assets", json={"upload_ids": [id]}).status_code == 415


def test_an_upload_goes_on_where_it_stands_and_nowhere_else(client: TestClient) -> None:
    url = begin(client, 10)
    assert append(client, url, 0, b"12345").status_code == 204
    for offset in (0, 4, 6):
        refused = append(client, url, offset, b"x")
        assert (refused.status_code, refused.json()["code"]) == (409, "upload-offset-conflict")
        assert refused.headers["Upload-Offset"] == "5"
    refusal(append(client, url, 5, b"678901"), 413, "payload-too-large")
    assert client.head(url, headers=TUS).headers["Upload-Offset"] == "5"
    assert append(client, url, 5, b"67890").status_code == 204
    assert append(client, url, 10, b"").status_code == 204
    assert append(client, url, 5, b"67890").status_code == 409


def test_a_promised_sha256_is_checked(client: TestClient) -> None:
    url = begin(client, 5, sha256=hashlib.sha256(b"12345").hexdigest())
    assert append(client, url, 0, b"1234x").status_code == 460
    assert client.head(url, headers=TUS).headers["Upload-Offset"] == "0"
    assert append(client, url, 0, b"12345").status_code == 204


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 412),
        ({"Tus-Resumable": "0.2.2", "Upload-Length": "1"}, 412),
        (TUS, 400),
        (TUS | {"Upload-Length": "-1"}, 400),
        (TUS | {"Upload-Length": "0"}, 422),
        (TUS | {"Upload-Length": str(5 * 1024**3)}, 413),
        *(
            (TUS | {"Upload-Length": "5", "Upload-Metadata": wrong}, 422)
            for wrong in (
                *("filename %%%", metadata(sha256="abc"), metadata(name="x" * 5000), metadata(name="a\0b")),
                *(metadata(filename=name) for name in ("x" * 300, "a\nb", "\x1b[31m")),
            )
        ),
        (TUS | {"Upload-Length": "5", "Upload-Metadata": "a " + "A" * 9000}, 400),
    ],
)
def test_a_wrong_beginning_is_refused(client: TestClient, headers: dict[str, str], status: int) -> None:
    assert client.post("/v1/uploads", headers=headers).status_code == status


def test_a_wrong_continuation_is_refused(client: TestClient) -> None:
    url = begin(client, 5)
    assert client.patch(url, content=b"1", headers=TUS | {"Upload-Offset": "0"}).status_code == 415
    assert client.patch(url, content=b"1", headers=BYTES).status_code == 400
    assert client.patch(url, content=b"1", headers=BYTES | {"Upload-Offset": "x"}).status_code == 400
    assert client.head(url).status_code == 412
    unknown = "/v1/uploads/01ARZ3NDEKTSV4RRFFQ69G5FAV"
    assert append(client, unknown, 0, b"1").status_code == 404
    assert client.head(unknown, headers=TUS).status_code == 404
    refusal(client.post("/v1/assets", json={"upload_ids": [url.rpartition("/")[2]]}), 409, "conflict")


def test_an_upload_that_is_deleted_while_it_comes_leaves_nothing(client, services, monkeypatch) -> None:
    monkeypatch.setattr(append_module, "POLL_S", 0.02)
    record = upload(services.store, begin(client, 80).rpartition("/")[2])

    async def stalled() -> AsyncIterator[bytes]:
        yield b"1234"
        assert client.delete(f"/v1/uploads/{record.id}", headers=TUS).status_code == 204
        yield b"5678"
        await asyncio.sleep(60)

    async def one_request() -> None:
        with pytest.raises(ProblemError, match="another request goes on"):
            await asyncio.wait_for(append_body(services.owned_by(ANYONE), record, stalled(), 0), 60)

    asyncio.run(one_request())
    assert services.upload_parts.size(record.id) == 0
