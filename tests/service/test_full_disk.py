"""A small disk: space is reserved before bytes arrive, and the service goes on by itself."""

import io
import shutil
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from jobs.settings import Settings
from service.app import create_app
from tests.line import Handler, answering
from tests.service.conftest import refusal

MIB = 1024**2
TREE = b"v 0.5 0 0\nv 0 0 2\nv 1 0 2\nf 1 2 3\n"


def answer(_: int, handler: Handler) -> None:
    """A tree, and 200 MiB with and without an announced length."""
    if handler.path == "/tree.obj":
        handler.reply(200, TREE)
        return
    handler.send_response(200)
    if handler.path == "/announced.obj":
        handler.send_header("Content-Length", str(200 * MIB))
    handler.close_connection = True
    handler.end_headers()
    with suppress(OSError):
        for _ in range(200):
            handler.wfile.write(bytes(MIB))


@pytest.mark.parametrize("path", ["/announced.obj", "/endless.obj"])
def test_a_fetch_stops_before_the_disk_is_full(small_disk: Path, settings: Settings, path: str) -> None:
    with answering(answer) as line:
        where = line.url.removeprefix("http://")
        own = {"state_dir": small_disk, "min_free_bytes": 16 * MIB, "outbound_hosts": (where,)}
        with TestClient(create_app(settings.model_copy(update=own)), "http://localhost") as client:
            sent = client.post("/v1/assets", json={"url": f"http://{where}{path}"})
            upload = client.get(sent.headers["Location"], headers={"Prefer": "wait=30"}).json()
            assert (upload["state"], upload["error"]["code"]) == ("failed", "disk-full")
            assert shutil.disk_usage(small_disk).free > 32 * MIB  # nothing of it is left
            sent = client.post("/v1/assets", json={"url": f"http://{where}/tree.obj"})
            upload = client.get(sent.headers["Location"], headers={"Prefer": "wait=30"}).json()
            assert upload["state"] == "ready", upload


def test_a_zip_is_refused_before_it_is_unpacked_onto_a_full_disk(small_disk: Path, settings: Settings) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("tree.obj", TREE)
        archive.writestr("notes.txt", np.random.default_rng(0).integers(0, 2, MIB, np.uint8).tobytes() * 40)
    own = {"state_dir": small_disk, "min_free_bytes": 24 * MIB}
    with TestClient(create_app(settings.model_copy(update=own)), "http://localhost") as client:
        refusal(client.post("/v1/assets", files={"file": ("tree.zip", packed.getvalue())}), 503, "disk-full")
        assert shutil.disk_usage(small_disk).free > 48 * MIB
