"""Real uvicorn, real Valkey, real Celery worker, over HTTP; and what happens when one of them is killed."""

import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from dynamictree.formats.tensors.voxels import read_voxels
from tests.faults.conftest import SHORT, Service, start, stop
from tests.faults.shapes import bumpy_sphere
from tests.servers import wait_for


@pytest.mark.slow
@pytest.mark.parametrize(("killed", "seed"), [("worker and pool", 0), ("pool process", 1)])
def test_a_killed_worker_loses_no_job(service: Service, killed: str, seed: int) -> None:
    asset_id = service.upload("big.obj", bumpy_sphere(150, seed=seed))
    pid = service.worker_pid()
    url = service.create(type="voxelize", asset_id=asset_id, params={"resolution": 256})
    wait_for(lambda: service.client.get(url).json()["stages"][0]["state"] == "running", "the stage")
    if killed == "pool process":
        os.kill(pid, signal.SIGKILL)
    else:
        parent = psutil.Process(pid).parent()
        assert parent is not None
        os.killpg(os.getpgid(parent.pid), signal.SIGKILL)
    job = service.finish(url)
    assert (job["state"], job["attempt"]) == ("succeeded", 2), job
    service.whole_artifacts(url)


def test_a_mesh_goes_in_and_a_motion_comes_out(service: Service) -> None:
    wait_for(lambda: set(service.client.get("/readyz").json().values()) == {"ready", "ok"}, "the start of all parts")
    asset_id = service.upload("tree.obj", bumpy_sphere(12, width=0.2))
    params = {"num_steps": 1, "formats": ["ply", "glb", "motion", "png"]}
    url = service.create(type="animate", asset_id=asset_id, seed=3, params=params)
    job = service.finish(url)
    assert (job["state"], job["attempt"]) == ("succeeded", 1), job
    assert [stage["progress"] for stage in job["stages"]] == [1, 1, 1]  # type: ignore[attr-defined]
    names = set(service.whole_artifacts(url))
    assert names >= {"motion.ply.zip", "tree.glb", "motion.safetensors", "preview.png", "tree.spectrum.safetensors"}
    spectrum = service.client.get(f"/v1/spectra/{job['result']['spectrum_id']}").json()  # type: ignore[index]
    assert (spectrum["num_frequencies"], spectrum["seed"], spectrum["up_axis"]) == (16, 3, "+Z")
    again = service.finish(service.create(type="voxelize", asset_id=asset_id, seed=9))
    assert again["stages"][0]["cached"]  # type: ignore[index]
    voxels_id = again["result"]["voxels_id"]  # type: ignore[index]
    voxels = read_voxels(io.BytesIO(service.client.get(f"/v1/artifacts/{voxels_id}").content))
    assert voxels.grid.resolution == 128


def test_a_job_of_low_priority_gives_way_goes_on_and_is_canceled_within_a_step(service: Service) -> None:
    asset_id = service.upload("tree.obj", bumpy_sphere(20, seed=4, width=0.2))
    url = service.create(type="diffuse", asset_id=asset_id, priority="low", params={"num_steps": 1000})

    def reached(attempt: int) -> float:
        job = service.client.get(url).json()
        return float(job["stages"][1]["progress"]) if job["attempt"] == attempt else 0.0

    wait_for(lambda: reached(1), "a step")
    other = service.finish(service.create(type="voxelize", asset_id=asset_id, params={"resolution": 32}))
    assert (other["state"], service.client.get(url).json()["state"]) == ("succeeded", "running")
    progress = wait_for(lambda: reached(2), "a step of its next attempt")
    assert service.client.post(url + "/cancel").json()["state"] == "canceling"
    job = service.finish(url)
    assert job["state"] == "canceled"
    assert job["stages"][1]["progress"] - progress < 0.02  # type: ignore[index]


@pytest.mark.slow
def test_a_stop_hands_the_job_back_and_a_start_goes_on(tmp_path: Path) -> None:
    first = start(tmp_path / "state")
    asset_id = first.upload("big.obj", bumpy_sphere(150, seed=5))
    urls = [first.create(type="voxelize", asset_id=asset_id, params={"resolution": r}) for r in (256, 128)]
    wait_for(lambda: first.client.get(urls[0]).json()["state"] == "running", "the job")
    began = time.monotonic()
    assert stop(first) == 0
    assert time.monotonic() - began < 25
    second = start(tmp_path / "state")
    for url in urls:
        assert second.finish(url)["state"] == "succeeded"
        second.whole_artifacts(url)
    command = [sys.executable, "-m", "dynamictree.cli", "serve", "--port", "0", "--state-dir", str(tmp_path / "state")]
    locked = subprocess.run(command, capture_output=True, text=True, env=os.environ | SHORT, timeout=60, check=False)
    assert (locked.returncode, locked.stderr.count("\n")) == (2, 1)
    assert "in use" in locked.stderr
    children = psutil.Process(second.process.pid).children(recursive=True)
    second.client.close()
    second.process.kill()
    second.process.communicate()
    _, alive = psutil.wait_procs(children, timeout=30)
    assert alive == []
