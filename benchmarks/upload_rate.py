"""How fast a file goes in over HTTP, resumable (tus) and as multipart, and how much memory the API takes meanwhile.

`UPLOAD_BYTES` sets the size; the target is meant for 4 GiB. The client writes one buffer over and over to its socket
and takes part of the two cores; how much processor time the API itself takes for a GB is reported beside. The multipart
upload is refused in the end, because its bytes are no tree: it is timed to the answer, which comes after the last byte
was stored and hashed.
"""

import os
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from urllib.parse import urlsplit

import httpx
import psutil

from benchmarks._machine import machine
from benchmarks._served import processor_s, started

TARGET_MB_S = 200.0
SIZE = int(os.environ.get("UPLOAD_BYTES") or 512 * 1024**2)
RUNS = 3
BUFFER = os.urandom(4 * 1024**2)
MAX_BYTES = str(8 * 1024**3)


def run() -> dict[str, object]:
    with (
        tempfile.TemporaryDirectory(dir=os.environ.get("UPLOAD_FOLDER")) as folder,
        started(Path(folder), max_multipart_bytes=MAX_BYTES, max_upload_bytes=MAX_BYTES) as (url, pid),
    ):
        process = psutil.Process(pid)
        _tus(url, 64 * 1024**2)  # warms up
        before = process.memory_info().rss
        with _watched(process) as most:
            began_s = processor_s(pid)
            tus = [_tus(url, SIZE) for _ in range(RUNS)]
            tus_s = processor_s(pid)
            multipart = [_multipart(url, SIZE) for _ in range(RUNS)]
            multipart_s = processor_s(pid)
        after = process.memory_info().rss
    return {
        "value": round(SIZE / 1e6 / median(tus), 1),
        "unit": "MB/s",
        "target": TARGET_MB_S,
        "multipart_mb_s": round(SIZE / 1e6 / median(multipart), 1),
        "api_processor_s_a_gb": round((tus_s - began_s) / RUNS / SIZE * 1e9, 2),
        "multipart_processor_s_a_gb": round((multipart_s - tus_s) / RUNS / SIZE * 1e9, 2),
        "bytes": SIZE,
        "runs": RUNS,
        "api_memory_before_mb": round(before / 1e6),
        "api_memory_most_mb": round(most[0] / 1e6),
        "api_memory_after_mb": round(after / 1e6),
        "disk_mb_s": round(_disk_mb_s(), 1),
        **machine("uvicorn", "httptools", "uvloop"),
    }


def _tus(url: str, size: int) -> float:
    tus = {"Tus-Resumable": "1.0.0"}
    created = httpx.post(url + "/v1/uploads", headers=tus | {"Upload-Length": str(size)})
    where = url + created.headers["Location"]
    headers = tus | {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    began = time.perf_counter()
    status = _send("PATCH", where, headers, b"", size, b"")
    seconds = time.perf_counter() - began
    assert status == 204, status
    httpx.delete(where, headers=tus)
    return seconds


def _multipart(url: str, size: int) -> float:
    head = b'--B\r\nContent-Disposition: form-data; name="file"; filename="tree.obj"\r\n\r\n'
    tail = b"\r\n--B--\r\n"
    began = time.perf_counter()
    status = _send("POST", url + "/v1/assets", {"Content-Type": "multipart/form-data; boundary=B"}, head, size, tail)
    assert status in {415, 422}, status
    return time.perf_counter() - began


def _send(method: str, url: str, headers: dict[str, str], head: bytes, size: int, tail: bytes) -> int:
    where = urlsplit(url)
    sent = headers | {"Host": where.netloc, "Content-Length": str(len(head) + size + len(tail)), "Connection": "close"}
    lines = [f"{method} {where.path} HTTP/1.1", *(f"{name}: {value}" for name, value in sent.items())]
    with socket.create_connection((where.hostname, where.port)) as connection:
        connection.sendall("\r\n".join(lines).encode() + b"\r\n\r\n" + head)
        left = size
        while left:
            connection.sendall(memoryview(BUFFER)[: min(left, len(BUFFER))])
            left -= min(left, len(BUFFER))
        connection.sendall(tail)
        return int(connection.recv(4096).split(b" ", 2)[1])


def _disk_mb_s() -> float:
    """What the disk itself takes in, written in the same pieces and synced."""
    with tempfile.NamedTemporaryFile(dir=os.environ.get("UPLOAD_FOLDER")) as file:
        began = time.perf_counter()
        for _ in range(128):
            file.write(BUFFER)
        file.flush()
        os.fdatasync(file.fileno())
        return 128 * len(BUFFER) / 1e6 / (time.perf_counter() - began)


@contextmanager
def _watched(process: psutil.Process) -> Iterator[list[int]]:
    most, stopped = [0], threading.Event()

    def watch() -> None:
        while not stopped.wait(0.05):
            most[0] = max(most[0], process.memory_info().rss)

    thread = threading.Thread(target=watch)
    thread.start()
    yield most
    stopped.set()
    thread.join()
