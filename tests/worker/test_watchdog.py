"""A worker that no longer takes what waits for it."""

import time
from pathlib import Path

import pytest
from celery import Celery

from jobs.lifecycle.maintenance import RUN_JOB
from tests.servers import valkey, worker
from worker.watchdog import Idleness


def test_idle_is_who_takes_nothing_though_there_is_something() -> None:
    idle = Idleness(limit_s=120)
    assert not idle.too_long(waiting=3, busy=False, now=0)
    assert not idle.too_long(waiting=3, busy=False, now=119)
    assert idle.too_long(waiting=3, busy=False, now=120)


@pytest.mark.parametrize(("waiting", "busy"), [(0, False), (3, True)])
def test_the_time_begins_anew_with_work_or_with_an_empty_queue(waiting: int, busy: bool) -> None:
    idle = Idleness(limit_s=120)
    idle.too_long(waiting=3, busy=False, now=0)
    assert not idle.too_long(waiting=waiting, busy=busy, now=119)
    assert not idle.too_long(waiting=3, busy=False, now=200)
    assert idle.too_long(waiting=3, busy=False, now=320)


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
    deadline = time.monotonic() + 120
    while not client.control.inspect(timeout=2).ping():
        assert time.monotonic() < deadline, part.tail()
    client.control.cancel_consumer("cpu", reply=True, timeout=5)
    client.send_task(RUN_JOB, args=("01AAAAAAAAAAAAAAAAAAAAAAAA", 1), queue="cpu")
    assert part.process is not None
    part.process.wait(90)
    assert "none was taken for 3 s" in part.tail()
    client.close()
    queue.stop()
