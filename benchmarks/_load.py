"""A whole service with a busy worker, and a compiled load generator (`hey`, Debian's package) beside it."""

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from recipes.demo import grow_demo_tree, served

BUSY_JOBS = 40


@dataclass(frozen=True, kw_only=True)
class Load:
    """What the generator saw."""

    requests_s: float
    p50_ms: float
    p99_ms: float
    statuses: dict[int, int]


def generator() -> str:
    """Where `hey` is: HEY, or in the path."""
    found = os.environ.get("HEY") or shutil.which("hey")
    if not found:
        raise SystemExit("benchmarks: this one needs the load generator `hey` (apt install hey), or HEY that names it")
    return found


def load(url: str, *, rate: int, connections: int, seconds: int, body: str | None = None) -> Load:
    """Ask at a steady rate over some connections."""
    command = [generator(), "-c", str(connections), "-q", str(rate / connections), "-z", f"{seconds}s"]
    if body is not None:
        command += ["-m", "POST", "-T", "application/json", "-d", body]
    told = subprocess.run([*command, url], capture_output=True, text=True, check=True).stdout
    percent = {int(p): float(s) * 1e3 for p, s in re.findall(r"(\d+)%+ in ([\d.]+) secs", told)}
    found = re.search(r"Requests/sec:\s+([\d.]+)", told)
    assert found is not None, told
    statuses = {int(code): int(n) for code, n in re.findall(r"\[(\d{3})\]\s+(\d+) responses", told)}
    return Load(requests_s=float(found.group(1)), p50_ms=percent[50], p99_ms=percent[max(percent)], statuses=statuses)


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
