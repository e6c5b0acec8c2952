"""Half-done work on photos outlasts its job: the next job on them goes on there."""

import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from celery.exceptions import SoftTimeLimitExceeded

from dynamictree.errors import Cancelled, InputError
from dynamictree.reconstruct.film_photos import write_sharp_frames
from dynamictree.reconstruct.photos import read_photos
from jobs.records import AssetRecord, JobRecord
from jobs.states import JobState, JobType, stages_of
from jobs.storage.assets import add_asset
from jobs.storage.intermediates import remember_intermediate
from tests.formats.films import write_film
from tests.reconstruct.conftest import Orbit, orbit  # noqa: F401
from tests.rows import asset_row, job_row, stored_part
from tests.worker.conftest import hold, watch
from worker.attempt import Attempt, run_stages
from worker.cancellation import Watch
from worker.half_done import discard, half_done_folder, locked_folder
from worker.runtime import Runtime
from worker.tasks import end_attempt

FRAMES = 8
FILM = {"video_frames": FRAMES}


class Limited(Watch):
    """Ends the attempt at a share of a stage, as Celery's time limit does."""

    limit = 1.0

    def report(self, stage: JobType, progress: float, worked_s: float | None = None) -> None:
        super().report(stage, progress, worked_s)
        if progress > self.limit:
            raise SoftTimeLimitExceeded


def add_photos(runtime: Runtime, paths: list[Path]) -> AssetRecord:
    parts = tuple(
        replace(stored_part(runtime.artifacts, path), name=f"{path.parent.name}/{path.name}") for path in paths
    )
    row = asset_row(parts[0], now=0.0, kind="photos", parts=parts, prepared=None, expires_at=1e12)
    return add_asset(runtime.store, row)[0]


@pytest.fixture
def film(runtime: Runtime, tmp_path: Path) -> AssetRecord:
    return add_photos(runtime, [write_film(tmp_path / "walk.mp4", seconds=1.0)])


def reconstruct_job(runtime: Runtime, photos: AssetRecord, **params: object) -> JobRecord:
    job = job_row(photos, "reconstruct", now=runtime.store.clock(), params=params)
    return runtime.store.add_job(job, stages=stages_of("reconstruct", "photos"))[0]


def ended(runtime: Runtime, job: JobRecord, limit: float) -> JobRecord:
    """The job after its time limit, met at a share of the reconstruction."""
    lease = hold(runtime, job)
    with Limited(runtime, lease, stopping=lambda: False) as watching:
        watching.limit = limit
        with pytest.raises(SoftTimeLimitExceeded) as met:
            run_stages(runtime, watching)
    end_attempt(runtime, lease, met.value)
    return runtime.store.job(job.id)


def test_another_job_goes_on_after_a_time_limit(runtime: Runtime, film: AssetRecord, monkeypatch) -> None:
    monkeypatch.setattr("worker.confined_reading.write_confined_frames", write_sharp_frames)  # no child has to start
    monkeypatch.setattr("worker.confined_reading.read_confined", read_photos)
    first, second = (reconstruct_job(runtime, film, **more) for more in (FILM, FILM | {"splat_steps": 100}))
    failed = ended(runtime, first, 0.001)
    assert (failed.state, failed.error_code) == (JobState.FAILED, "time-limit")
    assert "run it again: it goes on where it was" in (failed.error_message or "")
    [frames] = half_done_folder(runtime.settings, first).glob("frames-*")
    written = {path.name: path.stat().st_mtime_ns for path in frames.iterdir()}
    assert len(written) == FRAMES
    ended(runtime, second, 0.002)
    assert [*runtime.settings.scratch_dir.glob("*/frames-*")] == [frames]
    assert {path.name: path.stat().st_mtime_ns for path in frames.iterdir()} == written
    ended(runtime, reconstruct_job(runtime, film, video_frames=9), 0.001)
    assert {path.name: path.stat().st_mtime_ns for path in frames.iterdir()} == written


def test_who_waits_takes_what_the_first_job_learned(runtime: Runtime, unread, tmp_path: Path, monkeypatch) -> None:
    first, second = (reconstruct_job(runtime, unread, **FILM) for _ in range(2))
    began, release = threading.Event(), threading.Event()
    learned = []

    def make(path: Path) -> None:
        began.set()
        release.wait(30)
        path.write_bytes(b"learned")
        learned.append(path)

    def recall(job: JobRecord) -> None:
        folder = tmp_path / job.id
        folder.mkdir()
        watching = watch(runtime, hold(runtime, job))
        attempt = Attempt(runtime=runtime, watch=watching, folder=folder, asset=unread)
        attempt.fetch()
        path = attempt.recall("reconstruct", folder, "reconstruction", make)
        assert path.read_bytes() == b"learned"
        done.append(job.id)

    remember = lambda *args, **options: (time.sleep(0.3), remember_intermediate(*args, **options))  # noqa: E731
    monkeypatch.setattr("worker.attempt.remember_intermediate", remember)
    monkeypatch.setattr("worker.half_done._POLL_S", 0.01)
    done: list[str] = []
    threads = [threading.Thread(target=recall, args=(job,)) for job in (first, second)]
    threads[0].start()
    assert began.wait(30)
    threads[1].start()
    time.sleep(0.2)
    release.set()
    for thread in threads:
        thread.join(60)
    assert done == [first.id, second.id]
    assert len(learned) == 1
    assert list(runtime.settings.scratch_dir.iterdir()) == []


@pytest.fixture
def unread(runtime: Runtime, tmp_path: Path) -> AssetRecord:
    """A film that nobody reads."""
    (tmp_path / "walk.mp4").write_bytes(b"film")
    return add_photos(runtime, [tmp_path / "walk.mp4"])


@pytest.fixture
def work(runtime: Runtime, unread: AssetRecord) -> Path:
    folder = half_done_folder(runtime.settings, reconstruct_job(runtime, unread, **FILM))
    folder.mkdir(parents=True)
    return folder


@pytest.fixture
def at_work(work: Path) -> Iterator[None]:
    with suppress(SoftTimeLimitExceeded), locked_folder(work, lambda: None):
        yield
        raise SoftTimeLimitExceeded


@pytest.mark.usefixtures("at_work")
def test_a_job_that_waits_can_be_canceled(work: Path) -> None:
    def cancel() -> None:
        raise Cancelled("asked to stop")

    with pytest.raises(Cancelled), locked_folder(work, cancel):
        raise AssertionError("two jobs in one folder")
    discard(work)
    assert work.is_dir()


def test_photos_that_cannot_be_used_leave_nothing(work: Path) -> None:
    with suppress(InputError), locked_folder(work, lambda: None):
        (work / "frames").mkdir()
        raise InputError("no photos")
    assert not work.exists()
    with suppress(InputError), locked_folder(work, lambda: None):
        (work / "views.json").touch()
        raise InputError("cameras, but no surface")
    assert work.is_dir()
