from collections.abc import Iterator
from hashlib import sha256

import pytest
from fastapi.testclient import TestClient

from jobs.records import AssetRecord
from jobs.settings import Settings
from service.app import create_app
from service.http.problems import ProblemError
from service.http.request_headers import parse_range
from service.services import Services
from tests.service.conftest import hold, publish, refusal
from tests.service.test_jobs import create

CONTENT = bytes(range(256)) * 20_000


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with TestClient(create_app(Settings(state_dir=tmp_path_factory.mktemp("state"))), "http://localhost") as opened:
        yield opened


@pytest.fixture
def url(client: TestClient, asset: AssetRecord, services: Services) -> str:
    job = create(client, asset)
    publish(services, hold(services, str(job["id"])), "voxelize", "tree.voxels.safetensors", CONTENT)
    return str(client.get(f"/v1/jobs/{job['id']}/artifacts").json()["artifacts"][0]["url"])


def test_the_whole_file_comes_with_its_hash(client: TestClient, url: str) -> None:
    response = client.get(url)
    assert response.content == CONTENT
    assert response.headers["ETag"] == f'"{sha256(CONTENT).hexdigest()}"'
    assert "tree.voxels.safetensors" in response.headers["Content-Disposition"]
    named = client.get(url, params={"filename": "oak \u2013 1/2.glb"}).headers["Content-Disposition"]
    assert named.endswith("filename*=UTF-8''oak%20%E2%80%93%201%2F2.glb")
    head = client.head(url)
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["Content-Length"] == str(len(CONTENT))


@pytest.mark.parametrize(
    ("range_header", "part"),
    [
        ("bytes=0-0", slice(0, 1)),
        ("bytes=100-1999999", slice(100, 2_000_000)),
        ("bytes=5000000-", slice(5_000_000, None)),
        ("bytes=-7", slice(-7, None)),
        ("bytes=-6000000", slice(0, None)),
        ("bytes=0-99999999999", slice(0, None)),
    ],
)
def test_a_range_gives_those_bytes(client: TestClient, url: str, range_header: str, part: slice) -> None:
    response = client.get(url, headers={"Range": range_header})
    assert response.status_code == 206
    assert response.content == CONTENT[part]
    start = part.indices(len(CONTENT))[0]
    assert response.headers["Content-Range"] == f"bytes {start}-{start + len(response.content) - 1}/{len(CONTENT)}"


@pytest.mark.parametrize("range_header", ["bytes=0-1,5-6", "bytes=5-1", "lines=1-2", "bytes=-", "bytes=x-y"])
def test_what_is_no_single_range_gives_the_whole(client: TestClient, url: str, range_header: str) -> None:
    response = client.get(url, headers={"Range": range_header})
    assert (response.status_code, len(response.content)) == (200, len(CONTENT))


@pytest.mark.parametrize("range_header", [f"bytes={len(CONTENT)}-", "bytes=-0", "bytes=9999999999999999999999-"])
def test_a_range_past_the_end_is_refused(client: TestClient, url: str, range_header: str) -> None:
    response = client.get(url, headers={"Range": range_header})
    assert (response.status_code, response.json()["code"]) == (416, "range-not-satisfiable")
    assert response.headers["Content-Range"] == f"bytes */{len(CONTENT)}"


def test_conditions_hold(client: TestClient, url: str) -> None:
    etag = client.head(url).headers["ETag"]
    for same in (etag, f"W/{etag}", "*"):
        assert client.get(url, headers={"If-None-Match": same}).status_code == 304
    assert client.head(url, headers={"If-None-Match": f'"x", {etag}'}).status_code == 304
    assert client.get(url, headers={"If-None-Match": '"x"'}).status_code == 200
    assert client.get(url, headers={"Range": "bytes=0-4", "If-Range": etag}).status_code == 206
    assert client.get(url, headers={"Range": "bytes=0-4", "If-Range": '"x"'}).status_code == 200


def test_bytes_that_were_removed_are_gone(client: TestClient, url: str, services: Services) -> None:
    services.artifacts.delete(sha256(CONTENT).hexdigest())
    assert client.get(url).status_code == 410


def test_voxels_are_no_spectrum(client: TestClient, url: str) -> None:
    assert "voxels" in refusal(client.get(url.replace("artifacts", "spectra")), 404, "not-found")["detail"]


def test_of_an_empty_file_there_is_no_range() -> None:
    with pytest.raises(ProblemError, match="lies outside"):
        parse_range("bytes=0-", 0)
