"""A small disk: space is reserved before bytes arrive, and the service goes on by itself."""

import io
import shutil
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from jobs.settings import Settings
from service.app import create_app

MIB = 1024**2
TREE = b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"


class Site(BaseHTTPRequestHandler):
    """A tree, and 200 MiB with and without an announced length."""

    def do_GET(self) -> None:
        self.send_response(200)
        if self.path == "/announced.obj":
            self.send_header("Content-Length", str(200 * MIB))
        self.end_headers()
        if self.path == "/tree.obj":
            self.wfile.write(TREE)
            return
        try:
            for _ in range(200):
                self.wfile.write(bytes(MIB))
        except OSError:
            return

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def _site() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Site)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.parametrize("path", ["/announced.obj", "/endless.obj"])
def test_a_fetch_stops_before_the_disk_is_full(small_disk: Path, settings: Settings, path: str) -> None:
    with _site() as where:
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
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tree.obj", TREE)
        archive.writestr("notes.txt", np.random.default_rng(0).integers(0, 2, MIB, np.uint8).tobytes() * 40)
    own = {"state_dir": small_disk, "min_free_bytes": 24 * MIB}
    with TestClient(create_app(settings.model_copy(update=own)), "http://localhost") as client:
        sent = client.post("/v1/assets", files={"file": ("tree.zip", packed.getvalue())})
        assert (sent.status_code, sent.json()["code"]) == (503, "disk-full"), sent.text
        assert shutil.disk_usage(small_disk).free > 48 * MIB
