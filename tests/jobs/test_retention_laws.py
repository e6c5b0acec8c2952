"""Assets, cached stages, artifacts and bytes: who shares them, and how long they stay."""

import pytest

from jobs.errors import ConflictError, GoneError, StorageAwayError
from jobs.lifecycle import attempts, maintenance
from jobs.records import AssetPart, AssetRecord, OutputFile
from jobs.settings import Settings
from jobs.storage import references
from jobs.storage.assets import add_asset, delete_asset, read_asset
from jobs.storage.intermediates import remember_intermediate
from jobs.store import Store
from tests.jobs.conftest import FILE, Clock, add_job, claim, make_asset, publish
from tests.rows import asset_row


def test_the_same_fingerprint_is_the_same_asset(store: Store, clock: Clock) -> None:
    first, new = add_asset(store, make_asset(clock.now))
    assert new
    clock.now += 100
    second, new = add_asset(store, make_asset(clock.now))
    assert not new
    assert (second.id, second.expires_at) == (first.id, clock.now + 1000)
    delete_asset(store, first.id)
    third, new = add_asset(store, make_asset(clock.now))
    assert new
    assert third.id != first.id


def test_an_asset_in_use_is_not_deleted(store: Store, asset: AssetRecord) -> None:
    job = add_job(store, asset)
    with pytest.raises(ConflictError, match=job.id):
        delete_asset(store, asset.id)
    store.cancel(job.id)
    delete_asset(store, asset.id)
    with pytest.raises(GoneError):
        read_asset(store, asset.id)
    with pytest.raises(GoneError):
        add_job(store, asset)


def test_retention_keeps_what_is_referred_to(store: Store, asset: AssetRecord, clock: Clock) -> None:
    lease = claim(store, add_job(store, asset).id)
    for digest in ("a" * 64, "b" * 64, FILE.sha256, "d" * 64):
        attempts.touch_blob(store, digest, 5)
    publish(store, lease)
    assert references.unreferenced_blobs(store, limit=9) == []  # all too young
    attempts.succeed(store, lease)
    clock.now += references.BLOB_GRACE_S + 1
    assert references.unreferenced_blobs(store, limit=9) == ["d" * 64]
    deleted: list[str] = []
    references.forget_blob(store, "d" * 64, deleted.append)
    assert deleted == ["d" * 64]
    maintenance.delete_expired(store, Settings(job_retention_s=10, artifact_retention_s=10))
    with pytest.raises(GoneError):
        read_asset(store, asset.id)
    with pytest.raises(GoneError):
        store.job(lease.job.id)
    assert sorted(references.unreferenced_blobs(store, limit=9)) == ["a" * 64, "b" * 64, FILE.sha256]


def test_a_shared_result_does_not_retain_the_upload_it_was_computed_from(store: Store, clock: Clock) -> None:
    upload = OutputFile(name="mesh", media_type="model/ply", sha256="e" * 64, bytes=5)
    for digest in (FILE.sha256, upload.sha256):
        attempts.touch_blob(store, digest, 5)
    remember_intermediate(store, "k" * 64, "motion", FILE, [upload])
    clock.now += references.BLOB_GRACE_S + 1
    assert references.unreferenced_blobs(store, limit=9) == [upload.sha256]
    assert attempts.cached_stage(store, "k" * 64) == (FILE,)


def test_referenced_bytes_hide_nothing_from_retention(store: Store, clock: Clock) -> None:
    referenced = tuple(AssetPart(name=f"{number}.jpg", sha256=f"{number:064x}", bytes=1) for number in range(5))
    add_asset(store, asset_row(referenced[0], now=clock.now, parts=referenced))
    for digest in (*(part.sha256 for part in referenced), "f" * 64):
        attempts.touch_blob(store, digest, 1)
    clock.now += references.BLOB_GRACE_S + 1
    assert references.unreferenced_blobs(store, limit=1) == ["f" * 64]


def test_bytes_that_are_sent_again_are_not_deleted(store: Store, clock: Clock) -> None:
    attempts.touch_blob(store, "d" * 64, 5)
    clock.now += references.BLOB_GRACE_S + 1
    assert references.unreferenced_blobs(store, limit=9) == ["d" * 64]
    attempts.touch_blob(store, "d" * 64, 5)
    deleted: list[str] = []
    references.forget_blob(store, "d" * 64, deleted.append)
    assert deleted == []
    clock.now += references.BLOB_GRACE_S + 1
    assert references.unreferenced_blobs(store, limit=9) == ["d" * 64]


def test_bytes_that_could_not_be_deleted_stay_known(store: Store, clock: Clock) -> None:
    def away(digest: str) -> None:
        raise StorageAwayError("away")

    attempts.touch_blob(store, "d" * 64, 5)
    clock.now += references.BLOB_GRACE_S + 1
    with pytest.raises(StorageAwayError):
        references.forget_blob(store, "d" * 64, away)
    assert references.unreferenced_blobs(store, limit=9) == ["d" * 64]
