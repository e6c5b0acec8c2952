"""Large bytes pass the API by where the operator says so: addresses of a real S3 server in, and out."""

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import obstore
import pytest
from fastapi.testclient import TestClient

from jobs.errors import SettingsError
from jobs.settings import Settings, read_settings
from jobs.storage.object_storage import open_objects
from service.app import create_app
from service.routes import uploads
from tests.rows import stored_part
from tests.servers import object_storage
from tests.service.conftest import hold, publish, refusal
from tests.service.test_assets import OBJ, PLAIN, send
from tests.service.tus import TUS, append, begin
from tests.worker.conftest import hold as hold_as_worker
from tests.worker.test_attempt import run
from worker.runtime import close_runtime, open_runtime


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    folder = tmp_path_factory.mktemp("presigned")
    server, environment = object_storage(folder)
    own = {"presigned_links": True, "destinations": ("s3://trees/out/{owner}",)}
    with pytest.MonkeyPatch.context() as patched:
        for name, value in environment.items():
            patched.setenv(name, value)
        server.start()
        with TestClient(create_app(read_settings(state_dir=folder / "state", **own)), "http://localhost") as opened:
            yield opened
        server.stop()


def test_bytes_go_to_object_storage_and_come_from_it(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "PART_BYTES", 50)
    url = begin(client, len(OBJ), filename="tree.obj")
    append(client, url, 0, OBJ[:20])  # what has come is not asked for again
    parts = client.post(f"{url}/parts").json()["parts"]
    assert [part["offset"] for part in parts] == list(range(20, len(OBJ), 50))
    for part in parts:
        put = httpx.put(part["url"], content=OBJ[part["offset"] : part["offset"] + part["bytes"]])
        assert put.status_code == 200, put.text
    assert append(client, url, len(OBJ), b"").status_code == 204
    assert client.get(url).json()["state"] == "received"
    asset = client.post("/v1/assets", json={"upload_ids": [url.rpartition("/")[2]]}).json()
    assert asset["parts"][0]["bytes"] == len(OBJ)

    services = client.app.state.services  # type: ignore[attr-defined]
    job = client.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset["id"]}).json()
    publish(services, hold(services, job["id"]), "voxelize", "tree.voxels.safetensors", b"voxels")
    listed = client.get(f"/v1/jobs/{job['id']}/artifacts").json()["artifacts"][0]
    redirect = client.get(listed["url"], follow_redirects=False)
    assert (redirect.status_code, redirect.headers["Cache-Control"]) == (307, "no-store")
    where = redirect.headers["Location"]
    assert httpx.get(where).content == b"voxels"
    assert httpx.get(where, headers={"Range": "bytes=1-3"}).content == b"oxe"
    assert httpx.get(urlsplit(where)._replace(query="").geturl()).is_client_error  # without the signature
    etag = client.head(listed["url"]).headers["ETag"]
    assert client.get(listed["url"], headers={"If-None-Match": etag}).status_code == 304


def test_a_piece_that_is_not_as_long_as_announced_makes_no_upload(client: TestClient) -> None:
    url = begin(client, len(OBJ), filename="tree.obj")
    [part] = client.post(f"{url}/parts").json()["parts"]
    assert httpx.put(part["url"], content=OBJ + b"more").status_code == 200
    refused = append(client, url, len(OBJ), b"")
    assert (refused.status_code, refused.headers["Upload-Offset"]) == (409, str(len(OBJ) + 4))
    assert client.delete(url, headers=TUS).status_code == 204


def test_products_are_copied_to_where_the_operator_allows(client: TestClient) -> None:
    """The last test on this service: its worker is of the same process and takes SQLite's locks along."""
    services = client.app.state.services  # type: ignore[attr-defined]
    body = {"type": "voxelize", "asset_id": send(client, ("tree.obj", PLAIN)).json()["id"]}
    below = (f"s3://trees/out/{end}" for end in ("../products", "%2e%2e/products", "a/.%2E/b", "a?b", "a#b"))
    for elsewhere in ("s3://others/out/a", "s3://trees/outside", "file:///etc", *below):
        refusal(client.post("/v1/jobs", json=body | {"destination": elsewhere}), 403, "forbidden")
    job = client.post("/v1/jobs", json=body | {"destination": "s3://trees/out/a b/7"}).json()
    runtime = open_runtime(services.settings)
    run(runtime, hold_as_worker(runtime, services.store.job(job["id"])))
    close_runtime(runtime)
    [listed] = client.get(f"/v1/jobs/{job['id']}/artifacts").json()["artifacts"]
    [copied] = obstore.list(open_objects("s3://trees/out/a b/7")).collect()
    assert (copied["path"], copied["size"]) == (listed["name"], listed["bytes"])
    assert client.post(f"/v1/jobs/{job['id']}/retry").json()["destination"] == "s3://trees/out/a b/7"
    with pytest.raises(SettingsError, match="destinations"):
        read_settings(artifacts_url="file:///tmp/x", destinations=("s3://trees/out",))


def test_a_folder_gives_no_addresses(tmp_path: Path) -> None:
    artifacts_url = (tmp_path / "artifacts").as_uri()
    settings = Settings(state_dir=tmp_path / "state", artifacts_url=artifacts_url, presigned_links=True)
    with TestClient(create_app(settings), "http://localhost") as client:
        refusal(client.post(f"{begin(client, 10)}/parts"), 409, "conflict")
        services = client.app.state.services  # type: ignore[attr-defined]
        (tmp_path / "file").write_bytes(b"x")
        assert services.artifacts.link(stored_part(services.artifacts, tmp_path / "file").sha256) is None
