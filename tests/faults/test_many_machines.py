"""API, two workers and a housekeeper that share no disk: PostgreSQL, Redis and S3 are all that they have in common."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from hashlib import sha256

import httpx
import pytest
import sqlalchemy as sa

from jobs.database import tables as t
from jobs.database.engine import open_engine
from tests import servers
from tests.faults.conftest import SHORT
from tests.faults.shapes import bumpy_sphere

pytestmark = pytest.mark.slow  # `make scale-out`

ENDED = {"succeeded", "failed", "canceled"}
MULTIPART_BYTES = 5 * 1024**2
"""obstore sends what is larger in parts."""


@dataclass(kw_only=True)
class Machines:
    """The parts, and a client of the API."""

    parts: Mapping[str, servers.Server]
    client: httpx.Client
    engine: sa.Engine

    def finish(self, url: str) -> dict[str, object]:
        def ended() -> dict[str, object] | None:
            job: dict[str, object] = self.client.get(url).json()
            return job if job["state"] in ENDED else None

        return servers.wait_for(ended, f"the end of {url}")

    def owners(self) -> set[str]:
        """Who runs a job now."""
        with self.engine.connect() as connection:
            lease_owners = sa.select(t.jobs.c.lease_owner).where(t.jobs.c.lease_owner.is_not(None))
            return set(connection.execute(lease_owners).scalars())


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    with ExitStack() as running:
        many = running.enter_context(servers.machines(tmp_path_factory.mktemp("machines"), SHORT))
        client = running.enter_context(httpx.Client(base_url=many.url, timeout=30))
        servers.wait_for(lambda: client.get("/readyz").json()["workers"] == "ok", "a worker")
        engine = open_engine(many.database_url)
        running.callback(engine.dispose)
        yield Machines(parts=many.servers, client=client, engine=engine)


def upload(machines: Machines, content: bytes) -> str:
    response = machines.client.post("/v1/assets", files={"file": ("tree.obj", content)})
    assert response.status_code == 201, response.text
    return str(response.json()["id"])


def create(machines: Machines, asset_id: str, resolution: int) -> str:
    body = {"type": "voxelize", "asset_id": asset_id, "params": {"resolution": resolution}}
    response = machines.client.post("/v1/jobs", json=body)
    assert response.status_code == 202, response.text
    return response.headers["Location"]


def assert_whole(machines: Machines, url: str) -> None:
    manifest = machines.client.get(url + "/artifacts").json()
    assert manifest["complete"]
    assert [artifact["name"] for artifact in manifest["artifacts"]] == ["tree.voxels.safetensors"]
    for artifact in manifest["artifacts"]:
        content = machines.client.get(artifact["url"]).content
        assert (len(content), sha256(content).hexdigest()) == (artifact["bytes"], artifact["sha256"])


def test_two_workers_share_the_jobs_and_one_takes_over_from_the_other(machines: Machines) -> None:
    content = bumpy_sphere(330)
    assert len(content) > MULTIPART_BYTES
    assets = [upload(machines, content), upload(machines, bumpy_sphere(100))]
    urls = [create(machines, asset_id, resolution) for resolution in (256, 128) for asset_id in assets]
    servers.wait_for(lambda: len(machines.owners()) == 2, "both workers at work")
    machines.parts["one"].kill()
    jobs = [machines.finish(url) for url in urls]
    assert [job["state"] for job in jobs] == ["succeeded"] * 4
    assert sorted(job["attempt"] for job in jobs) == [1, 1, 1, 2]  # type: ignore[type-var]
    for url in urls:
        assert_whole(machines, url)
    machines.parts["one"].start()
