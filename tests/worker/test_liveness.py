"""What a container's engine sees of our processes: a file that says a worker lives, and lines of JSON only."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.lifecycle.attempts import claim
from jobs.lifecycle.maintenance import WORKER_LEASES, end_expired, lease_names, worker_lease
from jobs.storage.assets import add_asset
from jobs.store import Store
from tests.jobs.conftest import add_job, make_asset
from tests.servers import api, valkey, wait_for, worker


def test_a_worker_renews_its_file_and_every_line_of_worker_and_api_is_json(tmp_path: Path) -> None:
    alive = tmp_path / "alive"
    queue, url = valkey(tmp_path)
    environment = {
        "DYNAMICTREE_REDIS_URL": url,
        "DYNAMICTREE_STATE_DIR": str(tmp_path / "state"),
        "DYNAMICTREE_WORKER_ALIVE_FILE": str(alive),
        "DYNAMICTREE_LOG_FORMAT": "json",
        "PYTHONWARNINGS": "ignore",  # Celery warns of root before there is a logger
    }
    works = worker(tmp_path, environment)
    often = "import celery.__main__, worker.app; worker.app.TOUCH_INTERVAL_S = 0.5; celery.__main__.main()"
    works.command[1:3] = ["-c", often, "--quiet"]  # as docker-compose.yml does
    serves, _ = api(tmp_path, environment)
    parts = (queue, serves, works)
    try:
        for part in parts:
            part.start()
        first = _changed(alive, 0.0)
        assert _changed(alive, first) > first
    finally:
        for part in reversed(parts):
            part.stop()
    assert not alive.exists()
    assert any(line["logger"].startswith("celery") for line in _lines(works.log))
    assert any(line["logger"] == "uvicorn.error" for line in _lines(serves.log))


def _changed(path: Path, since: float) -> float:
    deadline = time.monotonic() + 90
    while not path.exists() or path.stat().st_mtime <= since:
        assert time.monotonic() < deadline, "the worker does not touch its file"
        time.sleep(0.1)
    return path.stat().st_mtime


def _lines(path: Path) -> list[dict[str, str]]:
    """Every line but the one that Celery's signal handler writes past all logging."""
    lines = [line for line in path.read_text().splitlines() if line and line != "worker: Warm shutdown (MainProcess)"]
    return [json.loads(line) for line in lines]


def test_a_stopped_worker_loses_its_job_and_does_not_say_that_it_is_there(tmp_path: Path) -> None:
    store = Store.open(f"sqlite:///{tmp_path / 'jobs.sqlite'}")
    asset = add_asset(store, make_asset(store.clock()))[0]
    job = add_job(store, asset)
    assert claim(store, job.id, 1, owner="w", lease_s=1.5) is not None
    first = {"database_url": str(store.engine.url), "owner": "w", "queue": "gpu", "lease_s": 1.5, "heartbeat_s": 0.1}
    lines = [(json.dumps(line) + "\n").encode() for line in (first, {"job_id": job.id, "attempt": 1})]
    parent = "import subprocess, sys\n"
    beat = "import worker.heartbeat as beat; beat.PRESENCE_S = 0.4; beat.main()"
    parent += f"child = subprocess.Popen([sys.executable, '-c', {beat!r}], stdin=-1, stdout=-1)\n"
    parent += f"child.stdin.write({lines[0]!r}); child.stdin.flush(); child.stdout.readline()\n"
    parent += f"child.stdin.write({lines[1]!r}); child.stdin.flush(); child.wait()"
    worker_process = subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.DEVNULL)
    try:
        assert wait_for(lambda: lease_names(store, WORKER_LEASES)) == [worker_lease("gpu", "w")]
        begun = store.clock()
        wait_for(lambda: lease_end(store) > begun + 2 * 1.5)  # renewed for longer than it lasts
        assert end_expired(store, max_lost_attempts=2) == []
        worker_process.send_signal(signal.SIGSTOP)
        time.sleep(2.0)  # longer than each lease lasts
        assert not lease_names(store, WORKER_LEASES)
        assert end_expired(store, max_lost_attempts=2) == [(job.id, "running")]
        assert store.job(job.id).attempt == 2
        worker_process.send_signal(signal.SIGCONT)
        wait_for(lambda: lease_names(store, WORKER_LEASES))
    finally:
        worker_process.kill()
        worker_process.wait()
        store.close()


def lease_end(store: Store) -> float:
    with store.reading() as connection:
        return float(connection.execute(sa.select(t.jobs.c.lease_until)).scalar_one())
