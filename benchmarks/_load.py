"""A whole service with a busy worker, and a compiled load generator beside it: `h2load`, of Debian's nghttp2-client."""

import os
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from benchmarks._machine import machine
from recipes.demo import grow_demo_tree, served


@dataclass(frozen=True, kw_only=True)
class Load:
    """What the generator saw."""

    requests_s: float
    p50_ms: float
    p99_ms: float
    statuses: dict[int, int]

    def figures(self, *, target_ms: float) -> dict[str, object]:
        """The report of a benchmark whose value is the slowest hundredth."""
        return {
            "value": round(self.p99_ms, 1),
            "unit": "ms",
            "target": target_ms,
            "p50_ms": round(self.p50_ms, 1),
            "requests_s": round(self.requests_s, 1),
            "statuses": self.statuses,
            "load_generator": "h2load",
            **machine("uvicorn", "fastapi", "sqlalchemy"),
        }


def generator() -> str:
    """Where `h2load` is: H2LOAD, or in the path."""
    program = os.environ.get("H2LOAD") or shutil.which("h2load")
    if not program:
        raise SystemExit(
            "benchmarks: this one needs the load generator h2load (apt install nghttp2-client); H2LOAD may name it"
        )
    return program


def load(url: str, *, rate: int, connections: int, seconds: int, body: str | None = None) -> Load:
    """Ask at a steady rate over some connections, which begin one after another and so never ask all at once."""
    pause_ms = max(round(1000 / rate), 1)
    command = [generator(), "--h1", "-n", str(rate * seconds), "-c", str(connections), "--rps", str(rate / connections)]
    command += ["-r", "1", "--rate-period", f"{pause_ms}ms"]
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.tsv"
        if body is not None:
            content = Path(folder) / "body.json"
            content.write_text(body)
            command += ["-d", str(content), "-H", "content-type: application/json"]
        subprocess.run([*command, "--log-file", str(log), url], capture_output=True, check=True)
        answers = [tuple(map(int, line.split("\t"))) for line in log.read_text().splitlines()]
    began_us, status, took_us = zip(*answers, strict=True)
    taken_ms = sorted(us / 1e3 for us in took_us)
    return Load(
        requests_s=(len(answers) - 1) / (max(began_us) - min(began_us)) * 1e6,
        p50_ms=taken_ms[len(taken_ms) // 2],
        p99_ms=taken_ms[len(taken_ms) * 99 // 100],
        statuses=dict(Counter(status)),
    )


BUSY_JOBS = 40


@contextmanager
def busy_service() -> Iterator[tuple[str, str, str]]:
    """URL of a service whose worker has one thread and much to do, a job that runs, and an asset."""
    os.environ |= {"DYNAMICTREE_WORKER_THREADS": "1", "DYNAMICTREE_MAX_QUEUED_JOBS": "100000"}
    with tempfile.TemporaryDirectory() as folder:
        state = Path(folder) / "state"
        state.mkdir()
        mesh = grow_demo_tree(Path(folder) / "tree.glb")
        with served(state, Path(folder) / "serve.log") as url, httpx.Client(base_url=url, timeout=60) as client:
            asset = client.post("/v1/assets", files={"file": (mesh.name, mesh.read_bytes())}).json()["id"]
            for seed in range(BUSY_JOBS):
                wanted = {"type": "diffuse", "asset_id": asset, "seed": seed, "params": {"num_steps": 50}}
                job = client.post("/v1/jobs", json=wanted).raise_for_status().json()["id"]
            yield url, job, asset
