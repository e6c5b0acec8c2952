"""A rolling update with true old processes: `python -m tests.faults.rolling --old CHECKOUT`.

CHECKOUT is a clone of an earlier revision with an environment of its own (`make setup`). Old API and worker start on
an empty PostgreSQL; new API and housekeeper migrate it under them. Old and new then run jobs for one another. Prints a
line per step; ends with an error where a job does not succeed.
"""

import argparse
import json
import shutil
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import httpx
import sqlalchemy as sa

from jobs.database.engine import open_engine
from tests import servers
from tests.faults.conftest import SHORT, wait_for
from tests.faults.shapes import bumpy_sphere

TREE = Path(__file__).parents[2] / "web" / "examples" / "round-broadleaf.glb"
ENDED = {"succeeded", "failed", "canceled", "aborted"}


def _of(checkout: Path, server: servers.Server) -> servers.Server:
    """The same process, of another checkout's code and environment."""
    command = [str(checkout / ".venv" / "bin" / "python"), *server.command[1:]]
    return replace(server, name=f"old {server.name}", command=command, cwd=checkout)


def _tell(step: str, **facts: object) -> None:
    sys.stdout.write(json.dumps({"step": step} | facts) + "\n")
    sys.stdout.flush()


def _upload(client: httpx.Client, size: int) -> str:
    answer = client.post("/v1/assets", files={"file": ("tree.obj", bumpy_sphere(size))})
    assert answer.status_code in {200, 201}, answer.text
    return str(answer.json()["id"])


def _create(client: httpx.Client, asset: str, job_type: str, seed: int) -> str:
    params = {"num_steps": 4} if job_type == "diffuse" else {"resolution": 64}
    body = {"type": job_type, "asset_id": asset, "seed": seed, "params": params}
    answer = client.post("/v1/jobs", json=body)
    assert answer.status_code == 202, answer.text
    return str(answer.headers["Location"])


def _finish(client: httpx.Client, url: str) -> int:
    def ended() -> dict[str, object] | None:
        job: dict[str, object] = client.get(url).json()
        return job if job["state"] in ENDED else None

    job = wait_for(ended, f"the end of {url}", 300)
    assert job["state"] == "succeeded", job
    return int(str(job["attempt"]))


def _revision(url: str) -> str:
    engine = open_engine(url)
    with engine.connect() as connection:
        revision = str(connection.execute(sa.text("SELECT version_num FROM alembic_version")).scalar_one())
    engine.dispose()
    return revision


def roll(folder: Path, checkout: Path) -> None:
    """Every step."""
    database, database_url = servers.postgres(folder)
    queue, redis_url = servers.valkey(folder)
    shared = SHORT | {"DYNAMICTREE_DATABASE_URL": database_url, "DYNAMICTREE_REDIS_URL": redis_url}
    shared |= {"DYNAMICTREE_ARTIFACTS_URL": (folder / "artifacts").as_uri()}

    def on(machine: str) -> dict[str, str]:
        return shared | {"DYNAMICTREE_STATE_DIR": str(folder / machine)}

    with ExitStack() as running:
        running.callback(shutil.rmtree, database.cwd or "")

        def start(server: servers.Server) -> servers.Server:
            server.start()
            running.callback(server.stop, 30)
            return server

        start(database)
        start(queue)
        front, url = servers.api(folder, on("old-front"))
        start(_of(checkout, front))
        before = start(_of(checkout, servers.housekeeper(folder, on("old-keeper"))))
        worker = start(_of(checkout, servers.worker(folder, on("old-worker"), "old")))
        old = running.enter_context(httpx.Client(base_url=url, timeout=60))
        wait_for(lambda: old.get("/readyz").json()["workers"] == "ok", "the old worker", 120)
        asset = _upload(old, 40)
        _finish(old, _create(old, asset, "voxelize", 0))
        _tell("old alone", revision=_revision(database_url))
        new_front, new_url = servers.api(folder, on("front"))
        start(replace(new_front, log=folder / "new-api.log"))
        before.stop(30)
        start(replace(servers.housekeeper(folder, on("keeper")), log=folder / "new-keeper.log"))
        new = running.enter_context(httpx.Client(base_url=new_url, timeout=60))
        wait_for(lambda: new.get("/readyz").json()["housekeeper"] == "ok", "the new housekeeper", 120)
        _tell("new API and housekeeper", revision=_revision(database_url))
        for client, name in ((new, "new"), (old, "old")):
            assert client.get("/readyz").json()["status"] == "ready"
            _finish(client, _create(client, _upload(client, 44 if client is new else 48), "voxelize", 1))
            _tell(f"a job of the {name} API, run by the old worker")
        with TREE.open("rb") as stream:
            asset = new.post("/v1/assets", files={"file": (TREE.name, stream)}).json()["id"]
        url = _create(new, asset, "diffuse", 2)
        wait_for(lambda: new.get(url).json()["state"] == "running", "the job runs", 60)
        start(servers.worker(folder, on("worker"), "new"))
        time.sleep(1)
        worker.stop(60)
        _tell("the old worker is stopped, the new one goes on", attempt=_finish(new, url))
        _finish(old, _create(old, _upload(old, 52), "voxelize", 3))
        _tell("a job of the old API, run by the new worker")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--old", type=Path, required=True)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="rolling-") as folder:
        roll(Path(folder), given.old.resolve())


if __name__ == "__main__":
    main()
