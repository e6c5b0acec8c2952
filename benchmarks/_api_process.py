"""The real API in a separate process, with one spectrum for interaction."""

import io
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from dynamictree.formats.tensors.bundle import write_bundle
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.lifecycle.attempts import claim, publish_stage, start_stage, succeed
from jobs.records import AssetPart, AssetRecord, JobRecord, OutputFile
from jobs.settings import Settings
from jobs.states import JobState
from jobs.storage.artifacts import hash_file
from jobs.storage.assets import add_asset
from jobs.store import new_id
from service.services import Services, open_services

START_S = 90.0


@contextmanager
def serve_tree(state: Path, spectrum: SparseVoxelSpectrum, mesh: TriangleMesh) -> Iterator[tuple[str, str, int]]:
    """Context manager that runs an API with this tree; yields base URL, spectrum id and process id."""
    with open_services(Settings(state_dir=state)) as services:
        spectrum_id = store_spectrum(services, spectrum, mesh)
    with start_api(state) as (url, process_id):
        yield url, spectrum_id, process_id


@contextmanager
def start_api(state: Path, **settings: str) -> Iterator[tuple[str, int]]:
    """Context manager that runs an API on a state folder; yields base URL and process id. See docs/settings.md."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    command = [sys.executable, "-m", "uvicorn", "service.app:create_app", "--factory", "--port", str(port)]
    quiet = ["--log-level", "warning", "--no-access-log", "--loop", "uvloop", "--http", "httptools"]
    variables = {f"DYNAMICTREE_{name.upper()}": value for name, value in settings.items()}
    environment = os.environ | {"DYNAMICTREE_STATE_DIR": str(state)} | variables
    process = subprocess.Popen([*command, *quiet], env=environment)
    try:
        _wait(url)
        yield url, process.pid
    finally:
        process.terminate()
        process.wait(timeout=30)


def store_spectrum(services: Services, spectrum: SparseVoxelSpectrum, mesh: TriangleMesh) -> str:
    """Store a tree as a finished job does; return the spectrum's id."""
    services.settings.state_dir.mkdir(parents=True, exist_ok=True)
    now = services.store.clock()
    bundle, file = io.BytesIO(), io.BytesIO()
    write_bundle(mesh, bundle)
    write_spectrum(spectrum, file)
    digest, size = _stored(services, "mesh.safetensors", bundle.getvalue())
    part = AssetPart(name="mesh.safetensors", sha256=digest, bytes=size)
    asset = AssetRecord(
        id=new_id(),
        kind="mesh",
        fingerprint=digest,
        parts=(part,),
        prepared=part,
        summary={},
        created_at=now,
        expires_at=now + 1e6,
    )
    job = JobRecord(
        id=new_id(),
        type="diffuse",
        state=JobState.QUEUED,
        asset_id=add_asset(services.store, asset)[0].id,
        preset="small",
        seed=0,
        params={},
        queue="cpu",
        created_at=now,
    )
    services.store.add_job(job, stages=("diffuse",))
    lease = claim(services.store, job.id, 1, owner="benchmark", lease_s=60)
    assert lease is not None
    digest, size = _stored(services, "tree.spectrum.safetensors", file.getvalue())
    output = OutputFile(
        name="tree.spectrum.safetensors", media_type="application/octet-stream", sha256=digest, bytes=size
    )
    start_stage(services.store, lease, "diffuse")
    publish_stage(services.store, lease, "diffuse", (output,), key=digest, cached=False, retention_s=1e6)
    succeed(services.store, lease)
    return next(artifact.id for artifact in services.store.artifacts_of(job.id))


def processor_s(process_id: int) -> float:
    """Return the CPU time of a process and its ended children so far, user and system [s]; Linux only."""
    after_name = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, after_name[11:15])) / os.sysconf("SC_CLK_TCK")


def _stored(services: Services, name: str, content: bytes) -> tuple[str, int]:
    path = services.settings.state_dir / f"{new_id()}-{name}"  # the store hard-links this file
    path.write_bytes(content)
    digest, size = hash_file(path)
    services.artifacts.put(path, digest)
    return digest, size


def _wait(url: str) -> None:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        try:
            if httpx.get(url + "/livez", timeout=2).status_code == 200:
                return
        except httpx.TransportError:
            time.sleep(0.1)
    raise TimeoutError(f"the API did not answer within {START_S:g} s")
