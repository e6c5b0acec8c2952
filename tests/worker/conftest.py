from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynamictree.formats.tensors.bundle import write_bundle
from dynamictree.mesh import TriangleMesh
from jobs.lifecycle.attempts import claim
from jobs.records import AssetRecord, Claim, JobRecord
from jobs.settings import Settings
from jobs.states import JobType, stages_of
from jobs.storage.assets import add_asset
from tests.formats.meshes import written
from tests.rows import asset_row, job_row, stored_part
from worker.cancellation import Watch
from worker.runtime import Runtime, close_runtime, open_runtime


class NoHeartbeat:
    """Renews nothing: the lease outlasts the test."""

    def __init__(self, *_: object) -> None:
        self.wait = self.hold = self.drop = self.leave = lambda *_: None


@pytest.fixture
def beats() -> None:
    """For tests that need the heartbeat, whose process takes a second to start."""


@pytest.fixture
def runtime(tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Runtime]:
    beats = "beats" in request.fixturenames
    if not beats:
        monkeypatch.setattr("worker.runtime.Heartbeat", NoHeartbeat)
    times = {"lease_s": 2 if beats else 120, "heartbeat_s": 0.2}
    opened = open_runtime(Settings(state_dir=tmp_path / "state", **times))
    yield opened
    close_runtime(opened)


def wedge(height_m: float = 2.0) -> TriangleMesh:
    """A closed tetrahedron that stands on the ground."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, height_m]], np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    return TriangleMesh(vertices=vertices, faces=faces)


@pytest.fixture
def asset(runtime: Runtime, tmp_path: Path) -> AssetRecord:
    (path := tmp_path / "mesh.safetensors").write_bytes(written(write_bundle, wedge()))
    row = asset_row(stored_part(runtime.artifacts, path), now=runtime.store.clock())
    return add_asset(runtime.store, row)[0]


PARAMS = {
    "voxelize": {"resolution": 32},
    "diffuse": {"wind": {"speed_m_s": 5.0, "direction_deg": 0.0, "gust": 0.3}, "num_steps": 2},
    "animate": {
        "wind": {"speed_m_s": 5.0, "direction_deg": 0.0, "gust": 0.3},
        "num_steps": 2,
        "num_frames": None,
        "fps": 24.0,
        "speed": 1.0,
        "loop": True,
        "formats": ["ply", "motion"],
    },
}


def add_job(runtime: Runtime, asset: AssetRecord, job_type: JobType = "voxelize", **params: object) -> JobRecord:
    given = PARAMS[job_type] | params  # type: ignore[operator]
    job = job_row(asset, job_type, now=runtime.store.clock(), params=given)
    return runtime.store.add_job(job, stages=stages_of(job_type, asset.kind))[0]


def hold(runtime: Runtime, job: JobRecord, attempt: int = 1) -> Claim:
    runtime.heartbeat.wait()
    lease = claim(runtime.store, job.id, attempt, owner=runtime.owner, lease_s=runtime.settings.lease_s)
    assert lease is not None
    return lease


def watch(runtime: Runtime, lease: Claim, stopping: Callable[[], bool] = lambda: False) -> Watch:
    return Watch(runtime, replace(lease), stopping=stopping)
