import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from jobs.database.tables import metadata
from jobs.lifecycle import attempts
from jobs.records import AssetPart, AssetRecord, Claim, JobRecord, OutputFile
from jobs.states import JobType, stages_of
from jobs.storage.assets import add_asset
from jobs.store import Store
from tests.rows import asset_row, job_row
from tests.servers import postgres


@dataclass
class Clock:
    """A clock that moves only when a test moves it."""

    now: float = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(scope="session")
def postgres_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A PostgreSQL of our own on a unix socket; skipped where none is installed."""
    server, url = postgres(tmp_path_factory.mktemp("postgres"))
    server.start()
    yield url
    server.stop()
    shutil.rmtree(server.cwd or "")


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path: Path, clock: Clock) -> Iterator[Store]:
    if request.param == "sqlite":
        opened = Store.open(f"sqlite:///{tmp_path / 'jobs.sqlite'}", clock=clock)
        yield opened
        opened.close()
        return
    opened = Store.open(request.getfixturevalue("postgres_url"), clock=clock)
    yield opened
    with opened.engine.begin() as connection:
        for table in reversed(metadata.sorted_tables):
            connection.execute(table.delete())
    opened.close()


@pytest.fixture
def asset(store: Store, clock: Clock) -> AssetRecord:
    return add_asset(store, make_asset(clock.now))[0]


def make_asset(now: float, fingerprint: str = "f" * 64) -> AssetRecord:
    sent = AssetPart(name="tree.ply", sha256="a" * 64, bytes=10)
    prepared = AssetPart(name="mesh.safetensors", sha256="b" * 64, bytes=20)
    return asset_row(sent, now=now, fingerprint=fingerprint, prepared=prepared)


def add_job(store: Store, asset: AssetRecord, job_type: JobType = "diffuse", **values: object) -> JobRecord:
    job = job_row(asset, job_type, now=store.clock(), **values)
    return store.add_job(job, stages=stages_of(job_type, asset.kind))[0]


FILE = OutputFile(name="tree.voxels.safetensors", media_type="application/octet-stream", sha256="c" * 64, bytes=5)


def claim(store: Store, job_id: str, attempt: int = 1, owner: str = "worker-1") -> Claim:
    claimed = attempts.claim(store, job_id, attempt, owner=owner, lease_s=60)
    assert claimed is not None
    return claimed


def publish(store: Store, lease: Claim) -> None:
    attempts.publish_stage(store, lease, "voxelize", (FILE,), key="k" * 64, cached=False, retention_s=100)
