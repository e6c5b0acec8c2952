"""One error body, whatever goes wrong and wherever."""

import json
from collections.abc import Iterator

import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from dynamictree.errors import CheckpointError
from jobs.settings import Settings
from service.app import create_app
from service.http.problems import KINDS, problem_code
from service.http.validation_errors import MAX_ERRORS, field_errors
from tests.service.tus import TUS, metadata

MEMBERS = {"type", "title", "status", "detail", "code", "request_id", "retryable", "suggestion", "errors"}


def assert_problem(response: object, status: int, code: str) -> None:
    assert response.status_code == status, response.text  # type: ignore[attr-defined]
    assert response.headers["Content-Type"] == "application/problem+json"  # type: ignore[attr-defined]
    body = response.json()  # type: ignore[attr-defined]
    assert body.keys() >= MEMBERS
    assert (body["status"], body["code"], body["type"]) == (status, code, f"urn:dynamictree:problem:{code}")
    assert body["request_id"] == response.headers["X-Request-Id"]  # type: ignore[attr-defined]
    assert response.headers["X-Content-Type-Options"] == "nosniff"  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    app = create_app(Settings(state_dir=tmp_path_factory.mktemp("state"), max_json_bytes=2048))

    @app.get("/boom")
    def boom() -> None:
        raise ZeroDivisionError("a secret")

    @app.get("/model")
    def model() -> None:
        raise CheckpointError("a secret")

    @app.get("/database")
    def database() -> None:
        raise sa.exc.OperationalError("SELECT secret", {}, Exception("away"))

    with TestClient(app, "http://localhost", raise_server_exceptions=False) as opened:
        yield opened


JSON = {"Content-Type": "application/json"}


@pytest.mark.parametrize(
    ("send", "status", "code"),
    [
        (lambda client: client.get("/v1/nothing"), 404, "not-found"),
        *((lambda client, body=body: client.post("/v1/jobs", content=body, headers=JSON), 422, "validation-failed")
          for body in (b"{", b"\xff\xfe", b"")),
        (lambda client: client.post("/v1/jobs", json={"type": "x" * 4000}), 413, "payload-too-large"),
        (lambda client: client.post("/v1/jobs", content=(b" " * 1000 for _ in range(4)), headers=JSON), 413,
         "payload-too-large"),  # a body without a length
        (lambda client: client.post("/v1/jobs", content=b"{}", headers={"Content-Length": "-5"}), 413,
         "payload-too-large"),
        (lambda client: client.post("/v1/assets", content=b"x"), 415, "unsupported-format"),
    ],
)  # fmt: skip
def test_what_cannot_be_answered_is_a_problem(client, send, status, code) -> None:
    assert_problem(send(client), status, code)


@pytest.mark.parametrize(
    ("send", "words"),
    [
        (lambda client: client.post("/v1/assets", json={"upload_ids": ["x"]}), "26 letters and digits; 'x' was sent"),
        (lambda client: client.post("/v1/assets", json={"url": "https://a.example", "sha256": "x"}), "64 hexadecimal"),
        (lambda client: client.post("/v1/assets", json={"up_axis": "x,y"}), "X, Y or Z with a sign"),
        (lambda client: client.post("/v1/jobs", json={"type": "voxelize", "webhook": "x"}), "26 letters and digits"),
        (lambda client: client.get("/v1/jobs", params={"cursor": "x"}), "a next_cursor"),
        (lambda client: client.post("/v1/uploads", headers=TUS | {"Upload-Length": "5", "Upload-Metadata":
         metadata(filename="a\nb")}), "a name without control characters"),
    ],
)  # fmt: skip
def test_what_a_text_may_be_is_said_in_words(client: TestClient, send, words: str) -> None:
    response = send(client)
    assert_problem(response, 422, "validation-failed")
    assert words in response.text
    assert "pattern" not in response.text


def test_a_slash_too_many_sends_nobody_and_no_key_elsewhere(client: TestClient) -> None:
    answer = client.get("/v1/jobs/", follow_redirects=False)
    assert_problem(answer, 404, "not-found")
    assert "Location" not in answer.headers


@pytest.mark.parametrize(
    "path", ["/v1/assets/{}", "/v1/jobs/{}", "/v1/jobs/{}/artifacts", "/v1/artifacts/{}", "/v1/spectra/{}"]
)
@pytest.mark.parametrize("id", ["01ARZ3NDEKTSV4RRFFQ69G5FAV", "x", "%2e%2e", "%00", "ü"])
def test_an_unknown_id(client: TestClient, path: str, id: str) -> None:
    assert_problem(client.get(path.format(id)), 404, "not-found")


@pytest.mark.parametrize(
    ("path", "status", "code"),
    [("/boom", 500, "internal-error"), ("/model", 500, "model-error"), ("/database", 503, "storage-unavailable")],
)
def test_what_goes_wrong_inside_is_withheld(client, caplog, path, status, code) -> None:
    response = client.get(path)
    assert_problem(response, status, code)
    assert "secret" not in response.text
    assert "Retry-After" in response.headers or "a secret" in caplog.text


def test_a_valid_request_id_is_returned(client: TestClient) -> None:
    assert client.get("/livez", headers={"X-Request-Id": "abc-1"}).headers["X-Request-Id"] == "abc-1"
    assert len(client.get("/livez", headers={"X-Request-Id": "a b"}).headers["X-Request-Id"]) == 26


def test_an_unknown_code_is_internal() -> None:
    assert problem_code(ZeroDivisionError()) == "internal-error"
    assert all(200 <= kind.status < 600 and kind.suggestion for kind in KINDS.values())


@pytest.mark.parametrize(("path", "methods"), [("/v1/jobs", {"GET", "POST"}), ("/v1/jobs/0", {"GET", "DELETE"})])
def test_a_wrong_method_is_answered_with_every_allowed_one(client: TestClient, path: str, methods: set[str]) -> None:
    response = client.request("PATCH", path)
    assert_problem(response, 405, "method-not-allowed")
    assert set(response.headers["Allow"].split(", ")) == methods


@pytest.mark.parametrize(
    ("body", "pointer", "detail"),
    [
        ({"type": "fly"}, "/type", "'fly' was sent; 'reconstruct', 'voxelize', 'diffuse', 'animate' are allowed"),
        ({}, "/type", "this is needed, and was not sent"),
        ({"type": "diffuse"}, "/asset_id", "this is needed, and was not sent"),
        (
            {"type": "diffuse", "asset_id": "a", "seed": -1},
            "/seed",
            "Input should be greater than or equal to 0; -1 was",
        ),
        ({"type": "diffuse", "asset_id": "a", "a/b": 1}, "/a~1b", "there is no such field"),
        ({"type": "diffuse", "asset_id": ["a"]}, "/asset_id", "Input should be a valid string"),
        (
            {"type": "diffuse", "asset_id": "a", "params": {"wind": "strong"}},
            "/params/wind",
            "Input should be an object; 'strong' was sent",
        ),
        ("{", "", "this is no JSON: Expecting property name enclosed in double quotes at character 1"),
    ],
)
def test_a_wrong_field_is_reported_with_its_value(client: TestClient, body: object, pointer: str, detail: str) -> None:
    content = body if isinstance(body, str) else json.dumps(body)
    payload = client.post("/v1/jobs", content=content, headers=JSON).json()
    assert payload["errors"][0]["pointer"] == pointer
    assert payload["errors"][0]["detail"].startswith(detail)
    assert payload["detail"].startswith(f"{pointer or 'the body'}: {detail}")


def test_a_body_that_is_not_called_json_is_reported(client: TestClient) -> None:
    assert "Content-Type: application/json" in client.post("/v1/jobs", content=b"type=animate").json()["detail"]


def test_what_is_not_there_names_the_path_and_what_may_be_done(client: TestClient) -> None:
    assert "'/v1/job'" in client.get("/v1/job").json()["detail"]
    assert client.delete("/v1/jobs").json()["detail"] == "DELETE is not allowed at '/v1/jobs'; GET, POST are"


def test_errors_are_bounded() -> None:
    undocumented = [
        {"type": "extra_forbidden", "loc": ("body", "a" * 1000 + str(n)), "msg": "", "input": 1} for n in range(50_000)
    ]
    errors = field_errors(undocumented)
    assert len(errors) == MAX_ERRORS + 1
    assert "49980 more" in errors[-1]["detail"]
    assert len(json.dumps(errors)) < 20_000
