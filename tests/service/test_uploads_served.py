"""Uploads against a real server: a tus client that is not ours, connections that break, a server that is killed."""

import gc
import hashlib
import io
import os
import re
import socket
import subprocess
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest
from tusclient.client import TusClient

from jobs.settings import Settings
from tests.servers import Server, api, object_storage, wait_for
from tests.service.test_assets import MTL, OBJ, zipped
from tests.service.tus import BYTES, TUS

LENGTH = 24_000_000
CONTENT = np.random.default_rng(5).bytes(LENGTH)


@contextmanager
def forgiven() -> Iterator[None]:
    """The client leaves its connections to the garbage collector."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        yield
        gc.collect()


@pytest.fixture(scope="module", params=["folder", pytest.param("objects", marks=pytest.mark.slow)])
def server(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Server, str]]:
    folder = tmp_path_factory.mktemp("uploads")
    environment = {"DYNAMICTREE_STATE_DIR": str(folder / "state")}
    storage = None
    if request.param == "objects":
        storage, more = object_storage(folder)
        storage.start()
        environment |= more
    running, url = api(folder, environment)
    running.start()
    yield running, url
    running.stop()
    if storage is not None:
        storage.stop()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sent") / "tree.bin"
    path.write_bytes(CONTENT)
    return path


def begin(url: str) -> str:
    promised = hashlib.sha256(CONTENT).hexdigest()
    with forgiven(), io.BytesIO(CONTENT) as stream:
        uploader = TusClient(url + "/v1/uploads").uploader(
            file_stream=stream, metadata={"filename": "tree.bin", "sha256": promised}
        )
        created: str = uploader.create_url()
        del uploader
    return created


def send_part(url: str, offset: int, stop: int) -> socket.socket:
    """Promise the whole rest, send up to `stop`, and leave the connection open."""
    where = urlsplit(url)
    connection = socket.create_connection((where.hostname, where.port))
    headers = BYTES | {"Host": where.netloc, "Upload-Offset": str(offset), "Content-Length": str(LENGTH - offset)}
    head = (
        f"PATCH {where.path} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in headers.items()) + "\r\n"
    )
    connection.sendall(head.encode() + CONTENT[offset:stop])
    return connection


def stands_at(url: str) -> int:
    return int(httpx.head(url, headers=TUS).headers["Upload-Offset"])


def wait_until_at(url: str, least: int) -> int:
    wait_for(lambda: stands_at(url) >= least, f"{url} at {least}")
    return stands_at(url)


def finish(url: str, file: Path) -> None:
    """Go on in pieces with the tus client, which asks where the upload stands."""
    with forgiven(), file.open("rb") as stream:
        TusClient("").uploader(file_stream=stream, url=url, chunk_size=5_000_000).upload()
    headers = httpx.get(url).json()
    assert (headers["state"], headers["bytes_received"]) == ("received", LENGTH)


def test_an_upload_goes_on_at_the_byte_after_a_connection_that_broke(server: tuple[Server, str], file: Path) -> None:
    url = begin(server[1])
    send_part(url, 0, 9_000_001).close()
    assert wait_until_at(url, 9_000_001) == 9_000_001
    finish(url, file)


def test_a_new_connection_takes_over_from_one_that_hangs(server: tuple[Server, str], file: Path) -> None:
    url = begin(server[1])
    hanging = send_part(url, 0, 20_000_001)
    wait_until_at(url, 1)
    began = time.monotonic()
    refused = httpx.patch(url, content=b"", headers=BYTES | {"Upload-Offset": "0"}, timeout=60)
    assert refused.status_code == 409
    assert 0 < int(refused.headers["Upload-Offset"]) <= 20_000_001
    finish(url, file)
    assert time.monotonic() - began < Settings().upload_idle_s  # it was not waited for
    hanging.close()


def test_an_upload_goes_on_after_the_server_was_killed(server: tuple[Server, str], file: Path) -> None:
    running, base = server
    url = begin(base)
    hanging = send_part(url, 0, 20_000_001)
    wait_until_at(url, 1)
    running.kill()
    hanging.close()
    running.start()
    assert 0 < stands_at(url) <= 20_000_001
    finish(url, file)


@pytest.mark.parametrize("cut", [0, 100])
def test_the_commands_of_the_page_work(server: tuple[Server, str], tmp_path: Path, cut: int) -> None:
    """As a new user would type them, the second time after a line that broke."""
    page = (Path(__file__).parents[2] / "docs" / "uploads.md").read_text()
    [commands] = [block for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL) if "Upload-Offset" in block]
    commands = commands.replace("file=tree.glb", "file=tree.zip").replace(" | jq -r .id", "")
    (tmp_path / "tree.zip").write_bytes(zipped(("tree.obj", OBJ), ("tree.mtl", MTL)))
    if cut:
        begun, rest = commands.split("offset=", 1)
        commands = f"{begun}head -c {cut} $file | curl -s -X PATCH $upload -H \"$tus\" -H 'Upload-Offset: 0' "
        commands += f"-H 'Content-Type: application/offset+octet-stream' --data-binary @-\noffset={rest}"
    environment = os.environ | {"URL": server[1]}
    done = subprocess.run(
        ["bash", "-c", commands], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert '"kind":"mesh"' in done.stdout, done.stdout + done.stderr
