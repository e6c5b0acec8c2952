"""A disk that runs full: the housekeeper writes its lease again, retention frees space, and the reserve comes back."""

import shutil
from pathlib import Path

import pytest
import sqlalchemy as sa

from jobs.maintenance import HOUSEKEEPER_LEASE, hold_lease
from jobs.store import Store
from worker.disk_reserve import DiskReserve

MIB = 1024**2


def _fill(path: Path) -> None:
    with path.open("wb", buffering=0) as stream:
        try:
            while stream.write(bytes(MIB)) == MIB:
                pass
            while stream.write(bytes(1)):
                pass
        except OSError:
            return


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
