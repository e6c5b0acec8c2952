"""A disk that runs full: the housekeeper writes its lease again, retention frees space, and the reserve comes back."""

import shutil
from contextlib import suppress
from pathlib import Path

import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from jobs.errors import StorageFullError
from jobs.lifecycle.attempts import start_stage
from jobs.lifecycle.maintenance import HOUSEKEEPER_LEASE, hold_lease
from jobs.settings import Settings
from jobs.storage.assets import add_asset
from jobs.storage.disk import free_bytes, used
from jobs.store import Store
from service.app import create_app
from tests.rows import asset_row, stored_part
from tests.worker.conftest import add_job, hold, watch
from worker.cancellation import require_free_disk
from worker.housekeeper import DiskReserve
from worker.runtime import close_runtime, open_runtime

MIB = 1024**2


def _fill(path: Path) -> None:
    with suppress(OSError), path.open("wb", buffering=0) as stream:
        while stream.write(bytes(MIB)) == MIB:
            pass
        while stream.write(bytes(1)):
            pass


def _write_leases(store: Store, number: int) -> None:
    for index in range(number):
        hold_lease(store, f"{HOUSEKEEPER_LEASE}-{index}", owner="a", lease_s=10)


def test_a_full_disk_recovers_without_an_operator(small_disk: Path) -> None:
    reserve = DiskReserve(small_disk, 8 * MIB)
    reserve.balance()
    assert reserve.path.stat().st_blocks * 512 >= 8 * MIB  # allocated, not a hole
    store = Store.open(f"sqlite:///{small_disk / 'jobs.sqlite'}")
    expired = small_disk / "expired"
    _fill(expired)
    assert shutil.disk_usage(small_disk).free == 0
    with pytest.raises((sa.exc.OperationalError, OSError)):
        _write_leases(store, 200)
    reserve.balance()
    assert not reserve.path.exists()
    assert hold_lease(store, HOUSEKEEPER_LEASE, owner="a", lease_s=10)
    reserve.balance()
    assert not reserve.path.exists()  # not while the disk is nearly full
    expired.unlink()  # as retention does
    reserve.balance()
    assert reserve.path.exists()
    store.close()


def test_a_volume_is_full_at_its_own_size(tmp_path: Path) -> None:
    """The disk below it has more; half-received uploads that are linked twice count once."""
    settings = Settings(state_dir=tmp_path, min_free_bytes=8 * MIB, state_size_bytes=16 * MIB)
    used.cache_clear()
    assert free_bytes(settings) == 16 * MIB
    (tmp_path / "upload").write_bytes(bytes(11 * MIB))
    (tmp_path / "linked").hardlink_to(tmp_path / "upload")
    used.cache_clear()
    assert free_bytes(settings) == 5 * MIB
    require_free_disk(settings)
    with TestClient(create_app(settings), "http://localhost") as client:
        assert client.get("/readyz").json()["storage"] == "full"
        assert client.post("/v1/assets", files={"file": ("a.obj", b"v 0 0 0")}).json()["code"] == "disk-full"
    (tmp_path / "product").write_bytes(bytes(3 * MIB))
    used.cache_clear()
    with pytest.raises(StorageFullError):
        require_free_disk(settings)


def test_a_job_that_fills_the_disk_is_stopped_by_its_own_progress(small_disk: Path) -> None:
    """The check is part of what each stage calls between its steps."""
    settings = Settings(state_dir=small_disk, min_free_bytes=32 * MIB, progress_interval_s=0)
    runtime = open_runtime(settings)
    try:
        path = small_disk / "mesh"
        path.write_bytes(b"mesh")
        asset = add_asset(runtime.store, asset_row(stored_part(runtime.artifacts, path), now=runtime.store.clock()))[0]
        lease = hold(runtime, add_job(runtime, asset))
        settings.scratch_dir.mkdir(parents=True, exist_ok=True)
        with watch(runtime, lease) as watching:
            start_stage(runtime.store, lease, "voxelize")
            watching.report("voxelize", 0.1)
            (small_disk / "product").write_bytes(bytes(54 * MIB))
            with pytest.raises(StorageFullError):
                watching.report("voxelize", 0.2)
    finally:
        close_runtime(runtime)
