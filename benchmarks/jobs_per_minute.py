"""Many small trees at once: jobs per minute with one and with two worker processes, beside single jobs one by one.

Every worker has one thread. Then the same with two workers that share PostgreSQL, Redis and S3 and no disk, as on many
machines, where PostgreSQL is installed. Fairness between owners is a law of the store's tests.
DYNAMICTREE_BENCHMARK_BATCH shortens a run.
"""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import httpx
import pytest

from benchmarks._machine import machine
from benchmarks._trees import demo_mesh
from benchmarks._whole_service import WholeService, whole_service
from dynamictree.mesh import TriangleMesh
from jobs.states import queues_of
from tests import servers

VERTICES = 2000
SINGLE, BATCH = 5, int(os.environ.get("DYNAMICTREE_BENCHMARK_BATCH", "100"))
PARAMS = {"formats": ["glb"]}


def run() -> dict[str, object]:
    os.environ |= {"DYNAMICTREE_WORKER_THREADS": "1"}
    mesh = demo_mesh(VERTICES)
    with whole_service() as service:
        service.run(mesh, 0, **PARAMS)
        single_s = statistics.median(service.run(mesh, number, **PARAMS).wall_s for number in range(1, SINGLE + 1))
        one = _batch(service, mesh, 1000)
        with second_worker(service):
            service.run(mesh, 999, **PARAMS)
            two = _batch(service, mesh, 2000)
    shared = _on_servers(mesh)
    return {
        "value": round(two["jobs_per_minute"], 1),
        "unit": "jobs/min",
        "one_worker": one,
        "two_workers": two,
        "two_workers_on_servers": shared,
        "single_job_s": round(single_s, 2),
        "single_jobs_per_minute": round(60 / single_s, 1),
        "sizes": {"vertices": mesh.num_vertices, "batch": BATCH, **PARAMS},
        **machine("torch", "numpy"),
    }


def _on_servers(mesh: TriangleMesh) -> dict[str, float] | None:
    """Two workers on real servers; None where PostgreSQL is not installed."""
    with TemporaryDirectory() as name, ExitStack() as running:
        folder = Path(name)
        try:
            many = running.enter_context(servers.machines(folder, {"DYNAMICTREE_MAX_QUEUED_JOBS": "100000"}))
        except pytest.skip.Exception:
            return None
        client = running.enter_context(httpx.Client(base_url=many.url, timeout=60))
        service = WholeService(client, folder)
        service.run(mesh, 0, **PARAMS)
        service.run(mesh, 1, **PARAMS)
        return _batch(service, mesh, 1000)


def _batch(service: WholeService, mesh: TriangleMesh, first: int) -> dict[str, float]:
    assets = [service.upload(mesh, first + number) for number in range(BATCH)]
    began, spent = time.perf_counter(), service.worker_s()
    for job in [service.submit(asset, **PARAMS) for asset in assets]:
        service.wait(job)
    seconds = time.perf_counter() - began
    worker_s = (service.worker_s() - spent) / BATCH
    return {"jobs_per_minute": round(60 * BATCH / seconds, 1), "worker_s_per_job": round(worker_s, 2)}


@contextmanager
def second_worker(service: WholeService) -> Iterator[None]:
    """Another worker on the same queue, with one thread."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    environment = os.environ | threads | {"DYNAMICTREE_STATE_DIR": str(service.state)}
    queues = ",".join(queues_of("cpu"))
    command = [sys.executable, "-m", "celery", "--quiet", "-A", "worker.app", "worker", "-P", "prefork", "-c", "1"]
    command += ["-Q", queues, "-n", "second@%h", "--without-gossip", "--without-mingle", "-l", "warning"]
    with subprocess.Popen(command, env=environment) as process:
        deadline = time.monotonic() + 120
        while service.client.get("/metrics").text.find("dynamictree_workers 2.0") < 0 and time.monotonic() < deadline:
            time.sleep(0.5)
        try:
            yield
        finally:
            process.terminate()
            process.wait(timeout=60)
