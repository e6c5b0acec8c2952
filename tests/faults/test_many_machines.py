"""API, two workers and a housekeeper that share no disk: PostgreSQL, Redis and S3 are all that they have in common."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass

import httpx
import pytest
import sqlalchemy as sa

from jobs.database import tables as t
from jobs.database.engine import open_engine
from tests import servers
from tests.faults.conftest import SHORT, Running
from tests.faults.shapes import bumpy_sphere

pytestmark = pytest.mark.slow  # `make scale-out`

MULTIPART_BYTES = 5 * 1024**2
"""obstore sends what is larger in parts."""


@dataclass(kw_only=True)
class Machines(Running):
    """The parts."""

    parts: Mapping[str, servers.Server]
    engine: sa.Engine

    def owners(self) -> set[str]:
        """Who runs a job now."""
        with self.engine.connect() as connection:
            lease_owners = sa.select(t.jobs.c.lease_owner).where(t.jobs.c.lease_owner.is_not(None))
            return set(connection.execute(lease_owners).scalars())


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    with ExitStack() as running:
        many = running.enter_context(servers.machines(tmp_path_factory.mktemp("machines"), SHORT))
        client = running.enter_context(httpx.Client(base_url=many.url, timeout=120))
        servers.wait_for(lambda: client.get("/readyz").json()["workers"] == "ok", "a worker")
        engine = open_engine(many.database_url)
        running.callback(engine.dispose)
        yield Machines(parts=many.servers, client=client, engine=engine)


def test_two_workers_share_the_jobs_and_one_takes_over_from_the_other(machines: Machines) -> None:
    content = bumpy_sphere(330)
    assert len(content) > MULTIPART_BYTES
    assets = [machines.upload("tree.obj", mesh) for mesh in (content, bumpy_sphere(100))]
    urls = [
        machines.create(type="voxelize", asset_id=asset_id, params={"resolution": resolution})
        for resolution in (256, 128)
        for asset_id in assets
    ]
    servers.wait_for(lambda: len(machines.owners()) == 2, "both workers at work")
    machines.parts["one"].kill()
    jobs = [machines.finish(url) for url in urls]
    assert [job["state"] for job in jobs] == ["succeeded"] * 4
    assert sorted(job["attempt"] for job in jobs) == [1, 1, 1, 2]  # type: ignore[type-var]
    for url in urls:
        assert machines.whole_artifacts(url) == ["tree.voxels.safetensors"]
    machines.parts["one"].start()
