"""One attempt of a job, in this process, on the real store and the real stages."""

import os
import signal
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import sqlalchemy as sa
from celery.exceptions import SoftTimeLimitExceeded

from dynamictree.errors import Cancelled, MeshError
from dynamictree.export import write
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.formats.tensors.voxels import read_voxels
from dynamictree.requests import AnimateParams, VoxelizeParams
from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.clients.usage import months
from jobs.database import tables as t
from jobs.errors import FencedError, GoneError
from jobs.lifecycle.attempts import publish_stage, release_attempt, start_stage, succeed
from jobs.lifecycle.maintenance import end_expired, lease_names, worker_lease
from jobs.records import AssetRecord, Claim, JobRecord, OutputFile
from jobs.states import GPU, JobState, JobType
from jobs.storage.artifacts import hash_file
from jobs.storage.assets import read_asset
from jobs.storage.erasure import _forget_cached
from jobs.storage.intermediates import RESULT_SOURCES
from jobs.storage.stage_files import MESH_BUNDLE, SPECTRUM, VOXELS
from tests.formats.meshes import written
from tests.worker.conftest import add_job, hold, watch
from worker.attempt import PARAMS, run_stages, stage_key
from worker.cancellation import HandedBack
from worker.runtime import Runtime
from worker.tasks import end_attempt, metered


def run(runtime: Runtime, lease: Claim) -> None:
    with watch(runtime, lease) as watching:
        run_stages(runtime, watching)
    succeed(runtime.store, lease)


def content(runtime: Runtime, job_id: str, name: str) -> bytes:
    artifacts = {artifact.name: artifact for artifact in runtime.store.artifacts_of(job_id)}
    return b"".join(runtime.artifacts.read(artifacts[name].sha256))


def with_spectrum(runtime: Runtime, asset: AssetRecord, tmp_path: Path, **params: object) -> Claim:
    """Attempt 2 of an animate job; attempt 1 had made voxels and a spectrum, and was handed back."""
    return give_spectrum(runtime, add_job(runtime, asset, "animate", **params), tmp_path)


def give_spectrum(runtime: Runtime, job: JobRecord, tmp_path: Path) -> Claim:
    """Attempt 2 of a job whose first attempt had made voxels and a spectrum, and was handed back."""
    voxels_job = add_job(runtime, read_asset(runtime.store, job.asset_id))
    run(runtime, hold(runtime, voxels_job))
    grid = read_voxels(BytesIO(content(runtime, voxels_job.id, VOXELS))).grid
    coefficients = np.zeros((len(grid), 3, 3), np.complex64)
    coefficients[:, 1, 0] = 0.05 * grid.centres_m[:, 2]
    lease = hold(runtime, job)
    stages: tuple[tuple[JobType, str, bytes], ...] = (
        ("voxelize", VOXELS, content(runtime, voxels_job.id, VOXELS)),
        ("diffuse", SPECTRUM, written(write_spectrum, SparseVoxelSpectrum(grid=grid, coefficients=coefficients))),
    )
    for stage, name, result in stages:
        path = tmp_path / name
        path.write_bytes(result)
        digest, size = hash_file(path)
        runtime.artifacts.put(path, digest)
        start_stage(runtime.store, lease, stage)
        file = OutputFile(name=name, media_type="application/octet-stream", sha256=digest, bytes=size)
        publish_stage(runtime.store, lease, stage, (file,), key=digest, cached=False, retention_s=100)
    release_attempt(runtime.store, lease)
    return hold(runtime, job, attempt=2)


def test_the_same_stage_runs_once(runtime: Runtime, asset: AssetRecord) -> None:
    first, second, other = add_job(runtime, asset), add_job(runtime, asset), add_job(runtime, asset, resolution=64)
    for job in (first, second, other):
        run(runtime, hold(runtime, job))
    assert [runtime.store.job(job.id).stages[0].cached for job in (first, second, other)] == [False, True, False]
    assert content(runtime, first.id, VOXELS) == content(runtime, second.id, VOXELS)
    assert content(runtime, other.id, VOXELS) != content(runtime, first.id, VOXELS)


def test_a_cached_stage_whose_bytes_are_gone_runs_again(runtime: Runtime, asset: AssetRecord) -> None:
    first, second = add_job(runtime, asset), add_job(runtime, asset)
    run(runtime, hold(runtime, first))
    result = content(runtime, first.id, VOXELS)
    runtime.artifacts.delete(sha256(result).hexdigest())
    run(runtime, hold(runtime, second))
    assert not runtime.store.job(second.id).stages[0].cached
    assert content(runtime, second.id, VOXELS) == result


def test_the_next_attempt_goes_on_where_the_last_one_was(runtime: Runtime, asset: AssetRecord, tmp_path: Path) -> None:
    lease = with_spectrum(runtime, asset, tmp_path)
    run(runtime, lease)
    job = runtime.store.job(lease.job.id)
    assert (job.state, job.attempt) == (JobState.SUCCEEDED, 2)
    artifacts = runtime.store.artifacts_of(job.id)
    assert [artifact.name for artifact in artifacts] == [VOXELS, SPECTRUM, "motion.ply.zip", "motion.safetensors"]
    for artifact in artifacts:
        assert sha256(content(runtime, job.id, artifact.name)).hexdigest() == artifact.sha256


def test_another_format_does_not_compute_the_motion_again(runtime, asset, tmp_path, monkeypatch) -> None:
    computed = []
    whole = write.rig_of
    monkeypatch.setattr(write, "rig_of", lambda *given: computed.append(given) or whole(*given))
    contents = {}
    for number, formats in enumerate((["ply"], ["motion"], ["ply", "motion"])):
        folder = tmp_path / str(number)
        folder.mkdir()
        lease = with_spectrum(runtime, asset, folder, formats=formats)
        run(runtime, lease)
        names = [artifact.name for artifact in runtime.store.artifacts_of(lease.job.id)][2:]
        contents[number] = {name: content(runtime, lease.job.id, name) for name in names}
    assert len(computed) == 1
    assert contents[0] | contents[1] == contents[2]


def test_a_result_that_is_shared_is_erased_with_its_owner(runtime: Runtime, asset: AssetRecord, tmp_path: Path) -> None:
    run(runtime, with_spectrum(runtime, asset, tmp_path))
    with runtime.store.reading() as connection:
        rows = connection.execute(sa.select(t.stage_cache.c.stage, t.stage_cache.c.files)).all()
    shared = {row.stage: row.files for row in rows if row.stage in RESULT_SOURCES}
    assert {name: tuple(file["name"] for file in files[1:]) for name, files in shared.items()} == RESULT_SOURCES
    with runtime.store.writing() as connection:
        forgotten = _forget_cached(connection, {asset.prepared.sha256} if asset.prepared else set())
    assert {files[0]["sha256"] for files in shared.values()} <= forgotten


def test_a_cancel_is_honoured_at_the_next_step(runtime: Runtime, asset: AssetRecord, tmp_path: Path) -> None:
    lease = with_spectrum(runtime, asset, tmp_path)
    with watch(runtime, lease) as watching:
        watching.report("animate", 0.1)
        runtime.store.cancel(lease.job.id)
        with pytest.raises(Cancelled) as raised:
            run_stages(runtime, watching)
    end_attempt(runtime, lease, raised.value)
    assert runtime.store.job(lease.job.id).state == JobState.CANCELED
    assert list(runtime.settings.scratch_dir.iterdir()) == []


def test_a_worker_that_stops_hands_its_job_back(runtime: Runtime, asset: AssetRecord, tmp_path: Path) -> None:
    lease = with_spectrum(runtime, asset, tmp_path)
    with watch(runtime, lease, stopping=lambda: True) as watching, pytest.raises(HandedBack) as raised:
        run_stages(runtime, watching)
    end_attempt(runtime, lease, raised.value)
    job = runtime.store.job(lease.job.id)
    assert (job.state, job.attempt) == (JobState.RUNNING, 3)
    run(runtime, hold(runtime, job, attempt=3))


def holding_the_interpreter(seconds: float) -> None:
    """Keep every other thread of this process from running, as a long kernel does."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(100.0)
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        pass
    sys.setswitchinterval(before)


def test_what_attempts_took_is_added_to_job_and_month(runtime: Runtime, asset: AssetRecord) -> None:
    job = add_job(runtime, asset)
    on_gpu = replace(runtime, settings=runtime.settings.model_copy(update={"queue": GPU}))
    for resources, attempt in ((runtime, 1), (on_gpu, 2)):
        lease = hold(runtime, job, attempt)
        with suppress(HandedBack), metered(resources, lease):
            until = time.thread_time() + 0.2
            while time.thread_time() < until:
                continue
            raise HandedBack
        release_attempt(runtime.store, lease)
    [month] = months(runtime.store)
    assert month["attempts"] == 2
    for spent in (runtime.store.job(job.id).processor_s, month["processor_s"]):
        assert 0.4 <= spent < 2
    for spent in (runtime.store.job(job.id).gpu_s, month["gpu_s"]):
        assert 0.2 <= spent < 5


@pytest.mark.usefixtures("beats")
def test_the_heartbeat_outlasts_a_kernel_that_stops_all_threads(runtime: Runtime, asset: AssetRecord) -> None:
    lease = hold(runtime, add_job(runtime, asset))
    with watch(runtime, lease) as watching:
        holding_the_interpreter(runtime.settings.lease_s + 0.5)
        assert end_expired(runtime.store, max_lost_attempts=2) == []
        watching.check()
    runtime.store.clock = lambda: time.time() + runtime.settings.lease_s + 1
    assert end_expired(runtime.store, max_lost_attempts=2) == [(lease.job.id, JobState.RUNNING)]


def test_a_lost_lease_stops_the_attempt(runtime: Runtime, asset: AssetRecord) -> None:
    lease = hold(runtime, add_job(runtime, asset))
    with watch(runtime, lease) as watching:
        release_attempt(runtime.store, lease)
        with pytest.raises(FencedError, match="no longer ours"):
            watching.check()


def test_a_lost_lease_is_no_error_of_the_job_nor_a_loss_of_who_was_only_paused(runtime, asset, caplog) -> None:
    lease = hold(runtime, add_job(runtime, asset))
    runtime.store.clock = lambda: time.time() + runtime.settings.lease_s + 1
    assert end_expired(runtime.store, max_lost_attempts=2) == [(lease.job.id, JobState.RUNNING)]
    with pytest.raises(FencedError, match="the lease went"):
        end_attempt(runtime, lease, FencedError("the lease went"))
    assert (runtime.store.job(lease.job.id).state, caplog.records) == (JobState.RUNNING, [])
    with runtime.store.reading() as connection:
        assert connection.execute(sa.select(t.jobs.c.lost_stages)).scalar_one() == []


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (MeshError("found, allowed"), "invalid-geometry", "found, allowed"),
        (GoneError("it was deleted"), "expired", "it was deleted"),
        (MemoryError(), "out-of-memory", "memory"),
        (SoftTimeLimitExceeded(), "time-limit", "3300 s"),
        (ZeroDivisionError("a secret"), "internal-error", "logged"),
    ],
)
def test_an_error_is_written_as_code_and_message(runtime, asset, error, code, message) -> None:
    job = add_job(runtime, asset)
    end_attempt(runtime, hold(runtime, job), error)
    ended = runtime.store.job(job.id)
    assert (ended.state, ended.error_code) == (JobState.FAILED, code)
    assert message in (ended.error_message or "")
    assert "secret" not in (ended.error_message or "")


def test_a_loop_that_would_jump_fails_with_what_is_allowed(runtime, asset, tmp_path) -> None:
    lease = with_spectrum(runtime, asset, tmp_path, num_frames=37)
    with watch(runtime, lease) as watching, pytest.raises(Exception, match="period") as raised:
        run_stages(runtime, watching)
    end_attempt(runtime, lease, raised.value)
    assert runtime.store.job(lease.job.id).error_code == "invalid-input"


def test_a_key_changes_with_what_decides_the_stage(runtime: Runtime, asset: AssetRecord) -> None:
    job = add_job(runtime, asset)
    key = stage_key(job, "voxelize", {MESH_BUNDLE: "a"})
    assert stage_key(replace(job, seed=5, id="other"), "voxelize", {MESH_BUNDLE: "a", VOXELS: "b"}) == key
    assert stage_key(replace(job, params={"resolution": 64}), "voxelize", {MESH_BUNDLE: "a"}) != key
    assert stage_key(job, "voxelize", {MESH_BUNDLE: "c"}) != key
    owners = {stage_key(replace(job, owner=owner), "voxelize", {MESH_BUNDLE: "a"}) for owner in ("ann", "bob")}
    assert len(owners | {key}) == 3  # `cached: true` would tell one owner of another's bytes


@pytest.mark.usefixtures("beats")
def test_many_may_wait_for_the_first_beat(runtime: Runtime) -> None:
    threads = [threading.Thread(target=runtime.heartbeat.wait, daemon=True) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads)


@pytest.mark.usefixtures("beats")
def test_a_heartbeat_that_died_starts_again(runtime, asset, caplog) -> None:
    lease = hold(runtime, add_job(runtime, asset))
    with watch(runtime, lease):
        first = runtime.heartbeat.pid
        os.kill(first, signal.SIGKILL)
        os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    assert "heartbeat's process has died" in caplog.text
    runtime.heartbeat.wait()
    assert runtime.heartbeat.pid != first


@pytest.mark.usefixtures("beats")
def test_a_heartbeat_that_dies_before_its_first_beat_starts_again(runtime: Runtime) -> None:
    first = runtime.heartbeat.pid
    waiting = threading.Thread(target=runtime.heartbeat.wait, daemon=True)
    waiting.start()
    time.sleep(0.1)
    os.kill(first, signal.SIGKILL)
    waiting.join(60)
    assert not waiting.is_alive()
    assert runtime.heartbeat.pid != first
    assert lease_names(runtime.store, "worker:") == [worker_lease("cpu", runtime.owner)]
    runtime.heartbeat.leave()
    assert lease_names(runtime.store, "worker:") == []


def test_every_parameter_of_a_job_is_part_of_the_key_of_a_stage() -> None:
    hashed = {name for models in PARAMS.values() for model in models for name in model.model_fields}
    assert hashed == {*AnimateParams.model_fields, *VoxelizeParams.model_fields}
