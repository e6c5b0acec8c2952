"""A worker that no longer takes what waits for it."""

from pathlib import Path

import pytest
from celery import Celery

from jobs.lifecycle.maintenance import RUN_JOB
from tests.servers import valkey, wait_for, worker
from worker.watchdog import idle_since


@pytest.mark.parametrize(("waiting", "busy"), [(0, False), (3, True)])
def test_idle_is_who_takes_nothing_until_it_works_or_its_queue_is_empty(waiting: int, busy: bool) -> None:
    assert [idle_since(since, waiting=3, busy=False, now=120) for since in (None, 0)] == [120, 0]
    assert idle_since(0, waiting=waiting, busy=busy, now=121) is None


@pytest.mark.slow
def test_a_worker_that_stopped_consuming_ends(tmp_path: Path) -> None:
    queue, url = valkey(tmp_path)
    environment = {
        "DYNAMICTREE_REDIS_URL": url,
        "DYNAMICTREE_STATE_DIR": str(tmp_path / "state"),
        "DYNAMICTREE_IDLE_LIMIT_S": "3",
        "DYNAMICTREE_SHUTDOWN_GRACE_S": "20",
    }
    part = worker(tmp_path, environment)
    queue.start()
    part.start()
    client = Celery(broker=url)
    wait_for(client.control.inspect(timeout=2).ping, "the worker")
    client.control.cancel_consumer("cpu", reply=True, timeout=5)
    client.send_task(RUN_JOB, args=("01AAAAAAAAAAAAAAAAAAAAAAAA", 1), queue="cpu")
    assert part.process is not None
    part.process.wait(90)
    assert "none taken for 3 s" in part.tail()
    client.close()
    queue.stop()
