"""One attempt of a job, in this process, on the real store and the real stages."""

import os
import signal
import sys
import threading
import time
from dataclasses import replace
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from celery.exceptions import SoftTimeLimitExceeded

from dynamictree.errors import Cancelled, CheckpointError, MeshError
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.formats.tensors.voxels import read_voxels
from dynamictree.requests import AnimateParams, VoxelizeParams
from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.artifacts import hash_file
from jobs.attempts import hand_back, publish_stage, start_stage, succeed
from jobs.errors import FencedError, GoneError
from jobs.maintenance import living, reap
from jobs.records import AssetRecord, Claim, OutputFile
from jobs.stage_files import MESH_BUNDLE, SPECTRUM, VOXELS
from jobs.states import JobState, JobType
from tests.worker.conftest import add_job, hold, watch
from worker.attempt import PARAMS, model_sha256, run_stages, stage_key
from worker.cancellation import HandedBack
from worker.runtime import Runtime
from worker.tasks import end_attempt


def run(here: Runtime, held: Claim) -> None:
    with watch(here, held) as watching:
        run_stages(here, watching)
    succeed(here.store, held)


def content(here: Runtime, job_id: str, name: str) -> bytes:
    found = {artifact.name: artifact for artifact in here.store.artifacts_of(job_id)}
    return b"".join(here.artifacts.read(found[name].sha256))


def with_spectrum(here: Runtime, asset: AssetRecord, tmp_path: Path, **params: object) -> Claim:
    """Attempt 2 of an animate job; attempt 1 had made voxels and a spectrum, and was handed back."""
    voxels_job = add_job(here, asset)
    run(here, hold(here, voxels_job))
    grid = read_voxels(BytesIO(content(here, voxels_job.id, VOXELS))).grid
    coefficients = np.zeros((len(grid), 16, 3), np.complex64)
    coefficients[:, 1, 0] = 0.05 * grid.centres_m[:, 2]
    job = add_job(here, asset, "animate", **params)
    held = hold(here, job)
    stages: tuple[tuple[JobType, str, bytes], ...] = (
        ("voxelize", VOXELS, content(here, voxels_job.id, VOXELS)),
        ("diffuse", SPECTRUM, packed(SparseVoxelSpectrum(grid=grid, coefficients=coefficients))),
    )
    for stage, name, made in stages:
        path = tmp_path / name
        path.write_bytes(made)
        digest, size = hash_file(path)
        here.artifacts.put(path, digest)
        start_stage(here.store, held, stage)
        file = OutputFile(name=name, media_type="application/octet-stream", sha256=digest, bytes=size)
        publish_stage(here.store, held, stage, (file,), key=digest, cached=False, retention_s=100)
    hand_back(here.store, held)
    return hold(here, job, attempt=2)


def packed(spectrum: SparseVoxelSpectrum) -> bytes:
    stream = BytesIO()
    write_spectrum(spectrum, stream)
    return stream.getvalue()


def test_a_voxelize_job_makes_a_voxel_file(here: Runtime, asset: AssetRecord) -> None:
    job = add_job(here, asset)
    run(here, hold(here, job))
    voxels = read_voxels(BytesIO(content(here, job.id, VOXELS)))
    assert voxels.grid.resolution == 32
    assert here.store.job(job.id).state == JobState.SUCCEEDED
    assert list(here.settings.scratch_dir.iterdir()) == []


def test_the_same_stage_runs_once(here: Runtime, asset: AssetRecord) -> None:
    first, second, other = add_job(here, asset), add_job(here, asset), add_job(here, asset, resolution=64)
    for job in (first, second, other):
        run(here, hold(here, job))
    assert [here.store.job(job.id).stages[0].cached for job in (first, second, other)] == [False, True, False]
    assert content(here, first.id, VOXELS) == content(here, second.id, VOXELS)
    assert content(here, other.id, VOXELS) != content(here, first.id, VOXELS)


def test_a_stage_runs_anew_where_that_is_asked(here: Runtime, asset: AssetRecord) -> None:
    run(here, hold(here, add_job(here, asset)))
    job = add_job(here, asset, fresh_from="voxelize")
    run(here, hold(here, job))
    assert not here.store.job(job.id).stages[0].cached


def test_a_cached_stage_whose_bytes_are_gone_runs_again(here: Runtime, asset: AssetRecord) -> None:
    first, second = add_job(here, asset), add_job(here, asset)
    run(here, hold(here, first))
    made = content(here, first.id, VOXELS)
    here.artifacts.delete(sha256(made).hexdigest())
    run(here, hold(here, second))
    assert not here.store.job(second.id).stages[0].cached
    assert content(here, second.id, VOXELS) == made


def test_the_next_attempt_goes_on_where_the_last_one_was(here: Runtime, asset: AssetRecord, tmp_path: Path) -> None:
    held = with_spectrum(here, asset, tmp_path)
    run(here, held)
    job = here.store.job(held.job.id)
    assert (job.state, job.attempt) == (JobState.SUCCEEDED, 2)
    artifacts = here.store.artifacts_of(job.id)
    assert [artifact.name for artifact in artifacts] == [VOXELS, SPECTRUM, "motion.ply.zip", "motion.safetensors"]
    for artifact in artifacts:
        assert sha256(content(here, job.id, artifact.name)).hexdigest() == artifact.sha256


def test_a_cancel_is_honoured_at_the_next_step(here: Runtime, asset: AssetRecord, tmp_path: Path) -> None:
    held = with_spectrum(here, asset, tmp_path)
    with watch(here, held) as watching:
        watching.report("animate", 0.1)
        here.store.cancel(held.job.id)
        with pytest.raises(Cancelled) as raised:
            run_stages(here, watching)
    end_attempt(here, held, raised.value)
    assert here.store.job(held.job.id).state == JobState.CANCELED
    assert list(here.settings.scratch_dir.iterdir()) == []


def test_a_worker_that_stops_hands_its_job_back(here: Runtime, asset: AssetRecord, tmp_path: Path) -> None:
    held = with_spectrum(here, asset, tmp_path)
    with watch(here, held, stopping=lambda: True) as watching, pytest.raises(HandedBack) as raised:
        run_stages(here, watching)
    end_attempt(here, held, raised.value)
    job = here.store.job(held.job.id)
    assert (job.state, job.attempt) == (JobState.RUNNING, 3)
    run(here, hold(here, job, attempt=3))


def holding_the_interpreter(seconds: float) -> None:
    """Keep every other thread of this process from running, as a long kernel does."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(100.0)
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        pass
    sys.setswitchinterval(before)


def test_the_heartbeat_outlasts_a_kernel_that_stops_all_threads(here: Runtime, asset: AssetRecord) -> None:
    held = hold(here, add_job(here, asset))
    with watch(here, held) as watching:
        holding_the_interpreter(4.0)
        assert reap(here.store, max_lost_attempts=2) == []
        watching.check()
    here.store.clock = lambda: time.time() + here.settings.lease_s + 1
    assert reap(here.store, max_lost_attempts=2) == [(held.job.id, JobState.RUNNING)]


def test_a_lost_lease_stops_the_attempt(here: Runtime, asset: AssetRecord) -> None:
    held = hold(here, add_job(here, asset))
    with watch(here, held) as watching:
        hand_back(here.store, held)
        with pytest.raises(FencedError, match="no longer ours"):
            watching.check()


def test_a_lost_lease_leaves_what_the_next_attempt_goes_on_from(here: Runtime, asset: AssetRecord) -> None:
    held = hold(here, add_job(here, asset))
    with watch(here, held) as watching:
        hand_back(here.store, held)
        with pytest.raises(FencedError):
            run_stages(here, watching)
    assert [left.name for left in here.settings.scratch_dir.iterdir()] == [f"resume-{held.job.id}"]


def test_a_lost_lease_is_no_error_of_the_job(
    here: Runtime, asset: AssetRecord, caplog: pytest.LogCaptureFixture
) -> None:
    held = hold(here, add_job(here, asset))
    with pytest.raises(FencedError, match="the lease went"):
        end_attempt(here, held, FencedError("the lease went"))
    assert here.store.job(held.job.id).state == JobState.RUNNING
    assert caplog.records == []


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (MeshError("found, allowed"), "invalid-geometry", "found, allowed"),
        (GoneError("it was deleted"), "expired", "it was deleted"),
        (MemoryError(), "out-of-memory", "memory"),
        (SoftTimeLimitExceeded(), "time-limit", "3300 s"),
        (ZeroDivisionError("a secret"), "internal-error", "logged"),
    ],
)
def test_an_error_is_written_as_code_and_message(
    here: Runtime, asset: AssetRecord, error: Exception, code: str, told: str
) -> None:
    job = add_job(here, asset)
    end_attempt(here, hold(here, job), error)
    ended = here.store.job(job.id)
    assert (ended.state, ended.error_code) == (JobState.FAILED, code)
    assert told in (ended.error_message or "")
    assert "secret" not in (ended.error_message or "")


def test_a_loop_that_would_jump_fails_with_what_is_allowed(here: Runtime, asset: AssetRecord, tmp_path: Path) -> None:
    held = with_spectrum(here, asset, tmp_path, num_frames=37)
    with watch(here, held) as watching, pytest.raises(Exception, match="period") as raised:
        run_stages(here, watching)
    end_attempt(here, held, raised.value)
    assert here.store.job(held.job.id).error_code == "invalid-input"


def test_a_key_changes_with_what_decides_the_stage(here: Runtime, asset: AssetRecord) -> None:
    job = add_job(here, asset)
    key = stage_key(job, "voxelize", {MESH_BUNDLE: "a"})
    assert stage_key(replace(job, seed=5, id="other"), "voxelize", {MESH_BUNDLE: "a", VOXELS: "b"}) == key
    assert stage_key(replace(job, params={"resolution": 64}), "voxelize", {MESH_BUNDLE: "a"}) != key
    assert stage_key(job, "voxelize", {MESH_BUNDLE: "c"}) != key


def test_a_model_that_is_not_there_is_named() -> None:
    with pytest.raises(CheckpointError, match="no-such"):
        model_sha256("no-such")


def test_a_worker_says_that_it_is_there(here: Runtime) -> None:
    deadline = time.monotonic() + 20
    while not living(here.store, "worker:") and time.monotonic() < deadline:
        time.sleep(0.02)
    assert living(here.store, "worker:") == [f"worker:{here.owner}"]
    here.heartbeat.leave()
    assert living(here.store, "worker:") == []


def test_many_may_wait_for_the_first_beat(here: Runtime) -> None:
    threads = [threading.Thread(target=here.heartbeat.wait, daemon=True) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads)


def test_a_heartbeat_that_died_starts_again(
    here: Runtime, asset: AssetRecord, caplog: pytest.LogCaptureFixture
) -> None:
    held = hold(here, add_job(here, asset))
    with watch(here, held):
        first = here.heartbeat.pid
        os.kill(first, signal.SIGKILL)
        os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    assert "heartbeat's process has died" in caplog.text
    here.heartbeat.wait()
    assert here.heartbeat.pid != first


def test_a_heartbeat_that_dies_before_its_first_beat_starts_again(here: Runtime) -> None:
    first = here.heartbeat.pid
    waiting = threading.Thread(target=here.heartbeat.wait, daemon=True)
    waiting.start()
    time.sleep(0.1)
    os.kill(first, signal.SIGKILL)
    waiting.join(60)
    assert not waiting.is_alive()
    assert here.heartbeat.pid != first
    assert living(here.store, "worker:") == [f"worker:{here.owner}"]


def test_every_parameter_of_a_job_is_part_of_the_key_of_a_stage() -> None:
    hashed = {name for models in PARAMS.values() for model in models for name in model.model_fields}
    assert hashed == {*AnimateParams.model_fields, *VoxelizeParams.model_fields}
