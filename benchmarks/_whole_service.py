"""The whole service as `dynamictree serve` starts it, its jobs over HTTP, and their CPU time and memory."""

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from benchmarks._api_process import processor_s
from dynamictree.formats.gltf.writer import write_glb
from dynamictree.mesh import TriangleMesh
from recipes.demo import serve

POLL_S = 0.1
PATIENCE_S = 900.0
_LOG_TAIL = 6000  # characters of the service's log in an error


@dataclass(frozen=True, kw_only=True)
class JobTimes:
    """Times of a job, from its upload to the download of its last file."""

    wall_s: float
    worker_s: float  # CPU time of the worker
    stages_s: dict[str, float]


@dataclass(frozen=True)
class WholeService:
    """A client of a running service, and measurements of its worker processes."""

    client: httpx.Client
    state: Path

    def upload(self, mesh: TriangleMesh, number: int) -> str:
        """Upload a mesh, shifted by `number` micrometres so that no cache has seen it; return the asset's id."""
        shifted = mesh.vertices + np.float32([0, 0, 1e-6 * number])
        content = BytesIO()
        write_glb(TriangleMesh(vertices=shifted.astype(np.float32), faces=mesh.faces), content)
        name = f"tree-{number}.glb"
        response = self.client.post("/v1/assets", files={"file": (name, content.getvalue())}).raise_for_status()
        asset: str = response.json()["id"]
        return asset

    def submit(self, asset: str, **params: object) -> str:
        """Create a job for the motion of an asset; return the job's id."""
        body = {"type": "animate", "asset_id": asset, "params": params}
        job: str = self.client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
        return job

    def wait(self, job: str, patience_s: float = PATIENCE_S) -> dict[str, Any]:
        """Wait until a job has succeeded, and return it."""
        deadline = time.monotonic() + patience_s
        while time.monotonic() < deadline:
            answer: dict[str, Any] = self.client.get(f"/v1/jobs/{job}").raise_for_status().json()
            if answer["state"] == "succeeded":
                return answer
            if answer["state"] not in ("queued", "running"):
                log = (self.state.parent / "serve.log").read_text()
                raise RuntimeError(f"job {job} is {answer['state']}: {answer['error']}\n{log[-_LOG_TAIL:]}")
            time.sleep(POLL_S)
        raise TimeoutError(f"job {job} did not end within {patience_s:g} s")

    def run(self, mesh: TriangleMesh, number: int, **params: object) -> JobTimes:
        """Upload a mesh, wait for its products and download them."""
        before, began = self.worker_s(), time.perf_counter()
        job = self.wait(self.submit(self.upload(mesh, number), **params))
        for artifact in self.client.get(f"/v1/jobs/{job['id']}/artifacts").raise_for_status().json()["artifacts"]:
            self.client.get(artifact["url"]).raise_for_status()
        wall_s = time.perf_counter() - began
        return JobTimes(wall_s=wall_s, worker_s=self.worker_s() - before, stages_s=stage_seconds(job))

    def workers(self) -> list[int]:
        """Return the process ids of Celery's processes."""
        return [pid for pid in _descendants(os.getpid()) if b"worker.app" in _read(pid, "cmdline")]

    def worker_s(self) -> float:
        """Return the CPU time of the workers so far [s]."""
        return sum(processor_s(pid) for pid in self.workers())

    def peak_mb(self) -> float:
        """Return the largest peak memory of the worker processes [MiB]."""
        lines = [line for pid in self.workers() for line in _read(pid, "status").splitlines() if b"VmHWM" in line]
        return max(int(line.split()[1]) for line in lines) / 1024

    def forget_peak(self) -> None:
        """Reset `peak_mb`."""
        for pid in self.workers():
            Path(f"/proc/{pid}/clear_refs").write_text("5")


def stage_seconds(job: dict[str, Any]) -> dict[str, float]:
    """Return the duration of each stage of an ended job [s]."""
    times = {stage["name"]: (stage["started_at"], stage["finished_at"]) for stage in job["stages"]}
    moments = {name: [datetime.fromisoformat(text) for text in pair] for name, pair in times.items()}
    return {name: (end - start).total_seconds() for name, (start, end) in moments.items()}


@contextmanager
def whole_service() -> Iterator[WholeService]:
    """Context manager that runs a separate service in a temporary folder."""
    os.environ["DYNAMICTREE_MAX_QUEUED_JOBS"] = "100000"
    with tempfile.TemporaryDirectory() as folder:
        state = Path(folder) / "state"
        state.mkdir()
        with (
            serve(state, Path(folder) / "serve.log") as url,
            httpx.Client(base_url=url, timeout=PATIENCE_S) as client,
        ):
            yield WholeService(client, state)


def _descendants(parent: int) -> list[int]:
    try:
        children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    except OSError:
        return []
    return [pid for child in children for pid in (int(child), *_descendants(int(child)))]


def _read(pid: int, name: str) -> bytes:
    try:
        return Path(f"/proc/{pid}/{name}").read_bytes()
    except OSError:
        return b""
