from collections.abc import Callable, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from dynamictree.formats.tensors.mesh_bundle import write_mesh_bundle
from dynamictree.mesh import TriangleMesh
from jobs.assets import add_asset
from jobs.attempts import claim
from jobs.records import AssetRecord, Claim, JobRecord
from jobs.settings import Settings
from jobs.states import JobType, stages_of
from tests.rows import asset_row, job_row, kept
from worker.cancellation import Watch
from worker.runtime import Runtime, close_runtime, open_runtime


@pytest.fixture
def here(tmp_path: Path) -> Iterator[Runtime]:
    settings = Settings(state_dir=tmp_path / "state", lease_s=3, heartbeat_s=0.2, progress_interval_s=0)
    opened = open_runtime(settings)
    yield opened
    close_runtime(opened)


def wedge(height_m: float = 2.0) -> TriangleMesh:
    """A closed tetrahedron that stands on the ground."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, height_m]], np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    return TriangleMesh(vertices=vertices, faces=faces)


@pytest.fixture
def asset(here: Runtime, tmp_path: Path) -> AssetRecord:
    packed = BytesIO()
    write_mesh_bundle(wedge(), packed)
    path = tmp_path / "mesh.safetensors"
    path.write_bytes(packed.getvalue())
    row = asset_row(kept(here.artifacts, path), now=here.store.clock())
    return add_asset(here.store, row)[0]


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


def add_job(
    here: Runtime,
    asset: AssetRecord,
    job_type: JobType = "voxelize",
    *,
    fresh_from: JobType | None = None,
    **params: object,
) -> JobRecord:
    given = PARAMS[job_type] | params  # type: ignore[operator]
    job = job_row(asset, job_type, now=here.store.clock(), params=given, fresh_from=fresh_from)
    return here.store.add_job(job, stages=stages_of(job_type, asset.kind))[0]


def hold(here: Runtime, job: JobRecord, attempt: int = 1) -> Claim:
    here.heartbeat.wait()
    held = claim(here.store, job.id, attempt, owner=here.owner, lease_s=here.settings.lease_s)
    assert held is not None
    return held


def watch(here: Runtime, held: Claim, stopping: Callable[[], bool] = lambda: False) -> Watch:
    return Watch(here, replace(held), stopping=stopping)
