"""What the client does when the service is busy, the line breaks, or bytes are wrong."""

import asyncio
import base64
import hashlib
import itertools
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from pathlib import Path
from typing import get_args

import httpx
import pytest
from dynamictree_client import (
    AccessError,
    AsyncClient,
    Client,
    ClientError,
    ConflictError,
    GoneError,
    IntegrityError,
    InvalidRequestError,
    JobEndedError,
    NotFoundError,
    Retries,
    ServiceFaultError,
    TooBusyError,
    UnreachableError,
    WaitTimeoutError,
    asynchronous,
    operations,
    synchronous,
)
from dynamictree_client.models import Artifact, Asset, Job
from dynamictree_client.retries import retry_after_s

from tests.line import Handler, Line, answering

QUICK = Retries(attempts=4, first_wait_s=0.0)
TIMES = {"created_at": "2026-01-01T00:00:00Z", "expires_at": "2026-01-02T00:00:00Z"}
CONTENT = bytes(range(256)) * 64


@contextmanager
def talking(answer: Callable[[int, Handler], None], retries: Retries = QUICK) -> Iterator[tuple[Line, Client]]:
    """A server that answers so, and a client of it."""
    with answering(answer) as line, Client(line.url, retries=retries) as client:
        yield line, client


def artifact(**changes: object) -> Artifact:
    expected = {"id": "A", "name": "tree.glb", "stage": "animate", "media_type": "model/gltf-binary"}
    expected |= {"bytes": len(CONTENT), "sha256": hashlib.sha256(CONTENT).hexdigest(), "url": "/v1/artifacts/A"}
    return Artifact.model_validate(expected | TIMES | changes)


def job(state: str, **changes: object) -> bytes:
    first = {name: next(iter(get_args(field.annotation)), None) for name, field in Job.model_fields.items()}
    expected = {name: value if isinstance(value, str) else None for name, value in first.items()}
    expected |= {"id": "J", "type": "animate", "state": state, "asset_id": "A", "preset": "small", "seed": 0}
    expected |= {"params": {}, "metadata": {}, "attempt": 1, "progress": 0.5, "stages": [], "processor_s": 0.0}
    expected |= {"gpu_s": 0.0, "created_at": TIMES["created_at"]}
    return Job.model_construct(**(expected | changes)).model_dump_json(warnings=False).encode()


def test_a_busy_service_is_asked_again_when_it_says() -> None:
    def answer(number: int, handler: Handler) -> None:
        if number < 3:
            handler.problem(503, "queue-full", Retry_After="0")
        else:
            handler.reply(200, b'{"status": "ok"}')

    with talking(answer, Retries(first_wait_s=1000.0)) as (line, client):
        assert client.send(operations.get_liveness()).status == "ok"
    assert len(line.requests) == 3


def test_a_service_that_wants_to_be_left_alone_for_long_is_not_waited_for() -> None:
    with talking(lambda _, handler: handler.problem(429, "rate-limited", Retry_After="3600")) as (line, client):
        with pytest.raises(TooBusyError) as caught:
            client.send(operations.get_liveness())
        assert (caught.value.retry_after_s, caught.value.code, len(line.requests)) == (3600, "rate-limited", 1)


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        *((status, InvalidRequestError) for status in (400, 422)),
        *((status, AccessError) for status in (401, 403)),
        *((404, NotFoundError), (409, ConflictError), (410, GoneError), (501, ServiceFaultError), (503, TooBusyError)),
    ],
)
def test_a_problem_is_an_exception_of_its_kind(status: int, kind: type[Exception]) -> None:
    with talking(lambda _, handler: handler.problem(status, "some-code"), Retries(attempts=1)) as (line, client):
        with pytest.raises(kind, match="some-code: d s"):
            client.send(operations.get_job("J"))
        assert len(line.requests) == 1


def test_a_proxys_page_is_a_problem_too() -> None:
    with talking(lambda _, handler: handler.reply(502, b"<h1>Bad Gateway</h1>", "text/html")) as (line, client):
        with pytest.raises(ServiceFaultError, match=r"http-502: .*Bad Gateway"):
            client.send(operations.get_liveness())
        assert len(line.requests) == QUICK.attempts


def test_what_may_have_been_done_is_only_repeated_where_that_does_no_harm() -> None:
    with talking(lambda _, handler: handler.problem(500, "internal-error")) as (line, client):
        with pytest.raises(ServiceFaultError):
            client.send(operations.cancel_job("J"))
        assert len(line.requests) == 1
        with pytest.raises(ServiceFaultError):
            client.animate(Asset.model_construct(id="A"))
        created = [request for request in line.requests if request.path == "/v1/jobs"]
        assert len(created) == QUICK.attempts
        assert len({request.headers["idempotency-key"] for request in created}) == 1


def test_a_server_that_does_not_answer_is_reported_with_its_address() -> None:
    with (
        Client("http://127.0.0.1:9", retries=QUICK) as client,
        pytest.raises(UnreachableError, match=r"127\.0\.0\.1:9"),
    ):
        client.send(operations.get_liveness())


def test_a_download_that_breaks_off_goes_on_where_it_was(tmp_path: Path) -> None:
    def answer(number: int, handler: Handler) -> None:
        start = int(handler.headers.get("range", "bytes=0-").removeprefix("bytes=").removesuffix("-"))
        whole = CONTENT[start:]
        if number < 4:
            handler.break_off(whole[:5000], announced=len(whole), status=206 if start else 200)
        else:
            handler.reply(206, whole, "application/octet-stream", Content_Range=f"bytes {start}-/{len(CONTENT)}")

    with talking(answer) as (line, client):
        path = client.download(artifact(), tmp_path / "tree.glb")
    assert path.read_bytes() == CONTENT
    ranges = [request.headers.get("range") for request in line.requests]
    assert ranges == [None, "bytes=5000-", "bytes=10000-", "bytes=15000-"]
    assert line.requests[1].headers["if-range"] == f'"{artifact().sha256}"'
    assert list(tmp_path.iterdir()) == [path]


def test_a_download_of_an_earlier_process_goes_on(tmp_path: Path) -> None:
    (tmp_path / "tree.glb.part").write_bytes(CONTENT[:100])

    def answer(number: int, handler: Handler) -> None:
        handler.reply(206, CONTENT[100:], "application/octet-stream")

    async def fetch(url: str) -> Path:
        async with AsyncClient(url) as client:
            return await client.download(artifact(), tmp_path / "tree.glb")

    with answering(answer) as line:
        assert asyncio.run(fetch(line.url)).read_bytes() == CONTENT
    assert line.requests[0].headers["range"] == "bytes=100-"


def test_what_is_too_long_is_begun_anew_and_what_is_all_there_is_not_fetched(tmp_path: Path) -> None:
    part = tmp_path / "tree.glb.part"
    part.write_bytes(CONTENT + b"!")
    with talking(lambda _, handler: handler.reply(200, CONTENT, "application/octet-stream")) as (line, client):
        client.download(artifact(), tmp_path / "tree.glb").replace(part)
        assert client.download(artifact(), tmp_path / "tree.glb").read_bytes() == CONTENT
    assert len(line.requests) == 1
    assert "range" not in line.requests[0].headers


def test_wrong_bytes_are_thrown_away(tmp_path: Path) -> None:
    wrong = bytes(len(CONTENT))
    with talking(lambda _, handler: handler.reply(200, wrong, "application/octet-stream")) as (_, client):
        with pytest.raises(IntegrityError, match=hashlib.sha256(wrong).hexdigest()):
            client.download(artifact(), tmp_path / "tree.glb")
        assert list(tmp_path.iterdir()) == []


def test_a_download_that_never_gets_on_is_given_up(tmp_path: Path) -> None:
    with talking(lambda _, handler: handler.break_off(b"", announced=len(CONTENT))) as (line, client):
        with pytest.raises(UnreachableError):
            client.download(artifact(), tmp_path / "tree.glb")
        assert len(line.requests) == QUICK.attempts


@pytest.mark.parametrize("name", ["../evil", "/etc/evil", "a\\b", "..", ""])
def test_a_file_is_never_written_elsewhere(tmp_path: Path, name: str) -> None:
    manifest = {"job_id": "J", "complete": True, "artifacts": [artifact(name=name).model_dump(mode="json")]}
    body = json.dumps(manifest).encode()
    with talking(lambda _, handler: handler.reply(200, body)) as (line, client):
        with pytest.raises(IntegrityError, match="no plain name"):
            client.download_all("J", tmp_path / "out")
        assert len(line.requests) == 1


def test_waiting_asks_as_often_as_the_service_likes_and_tells_every_answer() -> None:
    states = ["queued", "running", "succeeded"]

    def answer(number: int, handler: Handler) -> None:
        handler.reply(200, job(states[number - 1]), Retry_After="0")

    seen = list[str]()
    with talking(answer) as (_, client):
        assert client.wait("J", on_progress=lambda now: seen.append(now.state)).state == "succeeded"
    assert seen == states


@pytest.mark.parametrize("state", ["failed", "canceled"])
def test_a_job_that_does_not_succeed_is_an_exception_that_says_why(state: str) -> None:
    error = {"type": "t", "title": "t", "status": 500, "detail": "It broke.", "code": "worker-lost", "request_id": None}
    error |= {"retryable": True, "suggestion": "Again.", "errors": []}
    with talking(lambda _, handler: handler.reply(200, job(state, error=error))) as (_, client):
        with pytest.raises(JobEndedError, match=rf"job J {state}: worker-lost: It broke\. Again\.") as caught:
            client.wait("J")
        assert caught.value.job.state == state


def test_waiting_ends_in_time() -> None:
    with talking(lambda _, handler: handler.reply(200, job("running"), Retry_After="30")) as (line, client):
        with pytest.raises(WaitTimeoutError, match="job J is running after 1 s"):
            client.wait("J", timeout_s=1)
        assert len(line.requests) == 1


def tus(failures: dict[int, int | None], stored: bytearray):  # type: ignore[no-untyped-def]
    """A server that keeps pieces; failures by the number of the piece: a status, or None for a broken line."""
    pieces = itertools.count(1)

    def answer(number: int, handler: Handler) -> None:
        if handler.command == "POST" and handler.path == "/v1/uploads":
            digest = base64.b64encode(hashlib.sha256(CONTENT).hexdigest().encode()).decode()
            assert handler.headers["upload-metadata"].endswith(f",sha256 {digest}")
            handler.reply(201, b"", Location="/v1/uploads/U", Upload_Offset="0")
        elif handler.command == "POST":
            handler.reply(201, ASSET)
        elif handler.command == "HEAD":
            handler.reply(200, b"", Upload_Offset=str(len(stored)))
        else:
            failure = failures.get(next(pieces), 204)
            assert int(handler.headers["upload-offset"]) == len(stored)
            if failure is None:
                stored.extend(handler.body)  # it came, but the answer did not
                handler.close_connection = True
            elif failure == 204:
                stored.extend(handler.body)
                handler.reply(204, b"", Upload_Offset=str(len(stored)))
            else:
                handler.problem(failure, "failed", Retry_After="0")

    return answer


ASSET = json.dumps({"id": "A", "kind": "mesh", "parts": [], "summary": {}, "metadata": {}} | TIMES).encode()


@pytest.mark.parametrize("failures", [{}, {1: None}, {2: 503, 3: 460}, {1: 409}], ids=str)
def test_an_upload_goes_on_where_the_line_broke(tmp_path, monkeypatch, failures) -> None:
    for client_module in (asynchronous, synchronous):
        monkeypatch.setattr(client_module, "PIECE", 7000)
    path = tmp_path / "tree.glb"
    path.write_bytes(CONTENT)
    stored = bytearray()
    with talking(tus(failures, stored)) as (line, client):
        assert client.upload(path, resumable=True, up_axis="+Y").id == "A"
    assert bytes(stored) == CONTENT
    assert line.requests[0].headers["upload-length"] == str(len(CONTENT))


def test_an_upload_that_is_never_in_step_is_given_up(tmp_path: Path) -> None:
    with talking(tus(dict.fromkeys(range(99), 460), bytearray())) as (_, client):
        path = tmp_path / "tree.glb"
        path.write_bytes(CONTENT)
        with pytest.raises(InvalidRequestError):
            client.upload_file(path)


def test_nothing_to_send_is_reported_before_anything_is_sent(tmp_path: Path) -> None:
    with Client("http://127.0.0.1:9", retries=QUICK) as client:
        with pytest.raises(ClientError, match="no files to send"):
            client.upload(tmp_path)
        with pytest.raises(ClientError, match=r"missing\.glb"):
            client.upload(tmp_path / "missing.glb")


def test_retry_after_is_read_in_both_of_its_forms() -> None:
    def seconds(value: str) -> float | None:
        return retry_after_s(httpx.Response(503, headers={"Retry-After": value}))

    assert seconds("7") == 7
    assert seconds("soon") is None
    in_a_minute = format_datetime(datetime.now(UTC) + timedelta(minutes=1), usegmt=True)
    assert seconds(in_a_minute) == pytest.approx(60, abs=2)
    assert seconds("Wed, 21 Oct 2015 07:28:00 GMT") == 0
    assert retry_after_s(httpx.Response(503)) is None


def test_without_retry_after_the_wait_doubles_up_to_a_limit() -> None:
    retries = Retries(attempts=100, first_wait_s=1.0, longest_wait_s=8.0, draw=lambda: 1.0)
    broken = httpx.ReadError("x")
    assert [retries.wait_s(n, broken, repeatable=True) for n in (1, 2, 3, 4, 5)] == [1, 2, 4, 8, 8]
    assert retries.wait_s(1, broken, repeatable=False) is None
    assert retries.wait_s(1, httpx.ConnectError("x"), repeatable=False) == 1
    assert retries.wait_s(100, broken, repeatable=True) is None
