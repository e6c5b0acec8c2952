from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from jobs.artifacts import hash_file
from jobs.assets import add_asset
from jobs.attempts import claim, publish_stage, start_stage
from jobs.records import AssetPart, AssetRecord, Claim, OutputFile
from jobs.settings import Settings
from jobs.states import JobType
from jobs.store import new_id
from service.app import create_app
from service.context import Context


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    # starlette opens its WebSockets as testserver, whatever the base
    return Settings(state_dir=tmp_path / "state", parser_cpu_s=60, hosts=("testserver",))


@pytest.fixture
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(settings), "http://localhost", raise_server_exceptions=False) as opened:
        yield opened


@pytest.fixture
def context(client: TestClient) -> Context:
    context: Context = client.app.state.context  # type: ignore[attr-defined]
    return context


@pytest.fixture
def asset(context: Context) -> AssetRecord:
    now = context.store.clock()
    part = AssetPart(name="tree.ply", sha256="a" * 64, bytes=10)
    record = AssetRecord(
        id=new_id(),
        kind="mesh",
        fingerprint="f" * 64,
        parts=(part,),
        prepared=part,
        summary={"num_vertices": 4},
        created_at=now,
        expires_at=now + 1000,
    )
    return add_asset(context.store, record)[0]


def hold(context: Context, job_id: str) -> Claim:
    """Claim a job as a worker does."""
    held = claim(context.store, job_id, 1, owner="test", lease_s=60)
    assert held is not None
    return held


def publish(context: Context, held: Claim, stage: JobType, name: str, content: bytes) -> None:
    """Publish one file of a stage as a worker does."""
    path = context.settings.state_dir / name
    path.write_bytes(content)
    digest, size = hash_file(path)
    context.artifacts.put(path, digest)
    file = OutputFile(name=name, media_type="application/octet-stream", sha256=digest, bytes=size)
    start_stage(context.store, held, stage)
    publish_stage(context.store, held, stage, (file,), key=digest, cached=False, retention_s=1000)
