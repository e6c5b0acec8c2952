"""deploy/nginx/dynamictree.conf in a real nginx with TLS, before a real API: everything that proxies break."""

import asyncio
import os
import shutil
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from websockets.asyncio.client import connect

from jobs.clients.keys import create_key
from jobs.store import Store
from tests import servers

NGINX = os.environ.get("NGINX") or shutil.which("nginx", path=f"{os.environ['PATH']}:/usr/sbin")
CONFIGURATION = Path(__file__).parents[2] / "deploy" / "nginx" / "dynamictree.conf"
CONNECTIONS_ALLOWED = 128
"""`limit_conn` of the file; the API behind would take 4096 from its proxy."""

MIB = 1024**2
TUS = {"Tus-Resumable": "1.0.0"}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(NGINX is None, reason="nginx is not installed (Debian: nginx)")]


@dataclass(frozen=True)
class Edge:
    url: str
    plain: str
    key: str
    trust: ssl.SSLContext
    folder: Path

    def client(self) -> httpx.Client:
        headers = {"Authorization": f"Bearer {self.key}"}
        return httpx.Client(base_url=self.url, headers=headers, verify=self.trust, timeout=30)


@pytest.fixture(scope="module")
def edge(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Edge]:
    folder = tmp_path_factory.mktemp("edge")
    queue, redis_url = servers.valkey(folder)
    environment = {
        "DYNAMICTREE_STATE_DIR": str(folder / "state"),
        "DYNAMICTREE_REDIS_URL": redis_url,
        "DYNAMICTREE_KEYS": "required",
        "DYNAMICTREE_MAX_CONNECTIONS_PER_ADDRESS": "4096",
        "FORWARDED_ALLOW_IPS": "127.0.0.1",
    }
    front, url = servers.api(folder, environment)
    queue.start()
    front.start()
    store = Store.open(f"sqlite:///{folder / 'state' / 'jobs.sqlite'}")
    _, key = create_key(store, name="edge", owner="ann", limits={"creates_per_min": 1000, "streams": 8})
    store.close()
    secure, plain = servers.free_port(), servers.free_port()
    program = _nginx(folder, url, secure, plain)
    try:
        for _ in range(100):
            if servers.listens(secure):
                break
            time.sleep(0.1)
        trust = ssl.create_default_context(cafile=str(folder / "cert.pem"))
        yield Edge(f"https://localhost:{secure}", f"http://localhost:{plain}", key, trust, folder)
    finally:
        program.terminate()
        program.wait(30)
        front.stop(20)
        queue.stop(20)


def _nginx(folder: Path, url: str, secure: int, plain: int) -> "subprocess.Popen[bytes]":
    assert NGINX is not None
    certificate = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    certificate += ["-addext", "subjectAltName=DNS:localhost", "-keyout", str(folder / "key.pem")]
    subprocess.run([*certificate, "-out", str(folder / "cert.pem")], check=True, capture_output=True)
    text = CONFIGURATION.read_text()
    for old, new in {
        "127.0.0.1:8000": url.removeprefix("http://"),
        "listen 443": f"listen 127.0.0.1:{secure}",
        "listen 80": f"listen 127.0.0.1:{plain}",
        "trees.example;": "localhost;",
        "/etc/ssl/trees.example/fullchain.pem": str(folder / "cert.pem"),
        "/etc/ssl/trees.example/privkey.pem": str(folder / "key.pem"),
    }.items():
        assert old in text, old
        text = text.replace(old, new)
    temporary = "".join(
        f"{name}_temp_path {folder / name};\n" for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    log = f"error_log {folder / 'nginx.log'} info;\npid {folder / 'nginx.pid'};\ndaemon off;\n"
    user = "user root;\n" if os.getuid() == 0 else ""
    whole = f"{user}{log}events {{ worker_connections 1024; }}\nhttp {{ access_log off;\n{temporary}{text} }}\n"
    (folder / "nginx.conf").write_text(whole)
    command = [NGINX, "-p", str(folder), "-c", str(folder / "nginx.conf")]
    return subprocess.Popen(command, stdout=sys.stderr, stderr=sys.stderr)


def test_keys_pass_and_what_has_no_key_stays_inside(edge: Edge) -> None:
    with edge.client() as client:
        response = client.get("/v1/presets")
        assert response.status_code == 200
        assert response.headers["strict-transport-security"]
        assert client.get("/livez").status_code == 200
        for path in ("/metrics", "/ops", "/ops/ops.js", "/v1/ops"):
            assert client.get(path).status_code == 404, path
    assert httpx.get(f"{edge.url}/v1/presets", verify=edge.trust).status_code == 401
    moved = httpx.get(f"{edge.plain}/v1/presets")
    assert (moved.status_code, moved.headers["location"].partition(":")[0]) == (308, "https")


def test_the_log_has_the_clients_address_not_what_it_claims(edge: Edge) -> None:
    with edge.client() as client:
        body = {"path": "/v1/artifacts/01ARZ3NDEKTSV4RRFFQ69G5FAV"}
        assert client.post("/v1/links", json=body, headers={"X-Forwarded-For": "8.8.8.8"}).status_code == 404
    assert "address=127.0.0.1" in (edge.folder / "api.log").read_text()


def test_an_upload_streams_through_and_a_broken_one_goes_on(edge: Edge) -> None:
    content = os.urandom(24 * MIB)
    with edge.client() as client:
        created = client.post("/v1/uploads", headers=TUS | {"Upload-Length": str(len(content))})
        assert created.status_code == 201, created.text
        place = created.headers["Location"]
        assert place.startswith("/v1/uploads/")

        def broken() -> Iterator[bytes]:
            yield content[: 12 * MIB]
            time.sleep(1)  # the API has them already, if the proxy does not gather
            raise KeyboardInterrupt

        head = TUS | {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
        with pytest.raises(KeyboardInterrupt):
            client.patch(place, headers=head | {"Content-Length": str(len(content))}, content=broken())
        time.sleep(1)
        there = int(client.head(place, headers=TUS).headers["Upload-Offset"])
        assert 4 * MIB <= there <= 12 * MIB
        rest = client.patch(place, headers=head | {"Upload-Offset": str(there)}, content=content[there:])
        assert (rest.status_code, rest.headers["Upload-Offset"]) == (204, str(len(content)))


def test_events_come_at_once_and_files_by_ranges(edge: Edge) -> None:
    tree = (Path(__file__).parents[2] / "web" / "examples" / "round-broadleaf.glb").read_bytes()
    with edge.client() as client:
        asset = client.post("/v1/assets", files={"file": ("tree.glb", tree)}).json()
        surface = client.get(f"/v1/assets/{asset['id']}/surface")
        assert surface.status_code == 200
        job = client.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset["id"]}).json()
        with client.stream("GET", f"/v1/jobs/{job['id']}/events") as events:
            began = time.monotonic()
            assert next(events.iter_lines())
            assert time.monotonic() - began < 5  # no worker: the job waits, and a proxy that gathers would too
        link = client.post("/v1/links", json={"path": f"/v1/assets/{asset['id']}/surface"}).json()["url"]
    anyone = httpx.get(edge.url + link, verify=edge.trust)
    assert anyone.status_code == 200, anyone.text
    assert len(anyone.content) == len(surface.content)  # its header's order differs from call to call


def test_a_websocket_passes(edge: Edge) -> None:
    async def talk() -> str:
        url = edge.url.replace("https", "wss") + "/v1/interact/stream"
        headers = {"Authorization": f"Bearer {edge.key}"}
        async with connect(url, ssl=edge.trust, additional_headers=headers, open_timeout=20) as stream:
            await stream.send("{}")
            return str(await stream.recv())

    assert "spectrum_id" in asyncio.run(talk())


def test_one_address_has_a_share_of_the_connections(edge: Edge) -> None:
    head = (
        f"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {edge.key}\r\nContent-Length: 10\r\n\r\n"
    )
    opened = []
    try:
        for _ in range(CONNECTIONS_ALLOWED + 10):
            plain = socket.create_connection(("127.0.0.1", _port(edge)))
            connection = edge.trust.wrap_socket(plain, server_hostname="localhost")
            connection.settimeout(10)
            connection.sendall(head.encode())  # no byte of the body follows
            opened.append(connection)
        assert [connection.recv(64).split(b" ")[1] for connection in opened[-10:]] == [b"503"] * 10
    finally:
        for connection in opened:
            connection.close()
    time.sleep(1)
    with edge.client() as client:
        assert client.get("/livez").status_code == 200


def _port(edge: Edge) -> int:
    return int(edge.url.rpartition(":")[2])
