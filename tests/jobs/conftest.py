import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from jobs.records import AssetPart, AssetRecord, JobRecord
from jobs.states import JobState, JobType, stages_of
from jobs.store import Store, new_id
from jobs.tables import metadata

NOBODY = 65534


@dataclass
class Clock:
    """A clock that stands until it is told to move."""

    now: float = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(scope="session")
def postgres_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A PostgreSQL of our own on a unix socket; skipped where none is installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb")) or [Path(shutil.which("initdb") or "initdb")]
    if not found[-1].is_file():
        pytest.skip("PostgreSQL is not installed")
    folder = Path(tempfile.mkdtemp(prefix="pg-"))  # short: a socket's path may have 107 bytes
    user: list[str] = []
    if os.getuid() == 0:  # PostgreSQL refuses to run as root
        os.chown(folder, NOBODY, NOBODY)
        user = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    subprocess.run([*user, found[-1], "-D", folder / "data", "-U", "tree", "-A", "trust"], check=True, **quiet)
    options = ["-D", folder / "data", "-k", folder, "-h", "", "-c", "fsync=off"]
    server = subprocess.Popen([*user, found[-1].with_name("postgres"), *options], **quiet)
    url = f"postgresql://tree@/postgres?host={folder}"
    deadline = time.monotonic() + 60
    while not (folder / ".s.PGSQL.5432").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    yield url
    server.terminate()
    server.wait()
    shutil.rmtree(folder)


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
    return store.add_asset(make_asset(clock.now))[0]


def make_asset(now: float, fingerprint: str = "f" * 64) -> AssetRecord:
    part = AssetPart(name="tree.ply", sha256="a" * 64, bytes=10)
    return AssetRecord(
        id=new_id(),
        kind="mesh",
        fingerprint=fingerprint,
        parts=(part,),
        prepared=AssetPart(name="mesh.safetensors", sha256="b" * 64, bytes=20),
        summary={"vertices": 4},
        created_at=now,
        expires_at=now + 1000,
    )


def add_job(store: Store, asset: AssetRecord, job_type: JobType = "diffuse", **values: object) -> JobRecord:
    job = JobRecord(
        id=new_id(),
        type=job_type,
        state=JobState.QUEUED,
        asset_id=asset.id,
        preset="small",
        seed=0,
        params={},
        queue="cpu",
        created_at=store.clock(),
        **values,
    )
    return store.add_job(job, stages=stages_of(job_type, asset.kind))[0]
