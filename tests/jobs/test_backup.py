"""A backup restores into an empty store with the same rows and bytes, whichever database either has."""

import gzip
import json
import threading
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest
import sqlalchemy as sa

from jobs.clients.keys import create_key
from jobs.clients.webhooks import add_endpoint
from jobs.database import tables as t
from jobs.errors import BackupError, ConflictError, NotFoundError
from jobs.lifecycle.attempts import finish_cancel, publish_stage, start_stage, succeed, touch_blob
from jobs.lifecycle.maintenance import hold_lease
from jobs.records import AssetPart, Claim, JobRecord, OutputFile
from jobs.storage.artifacts import FolderArtifacts
from jobs.storage.assets import add_asset, read_asset
from jobs.storage.backup import BACKUP_LEASE, BLOBS, back_up, restore, scrub
from jobs.storage.erasure import erase_owner
from jobs.storage.references import unreferenced_blobs
from jobs.storage.upload_parts import FolderParts
from jobs.storage.uploads import add_upload
from jobs.store import Store
from tests.jobs.conftest import add_job, claim, make_asset
from tests.rows import asset_row, upload_row


@pytest.fixture
def artifacts(tmp_path: Path) -> FolderArtifacts:
    return FolderArtifacts(tmp_path / "artifacts")


def _put(store: Store, artifacts: FolderArtifacts, folder: Path, content: bytes) -> AssetPart:
    path = folder / sha256(content).hexdigest()
    path.write_bytes(content)
    touch_blob(store, path.name, len(content))
    artifacts.put(path, path.name)
    return AssetPart(name="file", sha256=path.name, bytes=len(content))


def fill(store: Store, artifacts: FolderArtifacts, folder: Path, owner: str, *, seed: str = "") -> JobRecord:
    """A key, an upload, a webhook, and a job with one product, all of one owner."""
    folder.mkdir(exist_ok=True)
    theirs = store.for_owner(owner)
    create_key(store, name="k", owner=owner)
    add_endpoint(theirs, "https://tree.example/", ())
    add_upload(theirs, upload_row(f"{owner}{seed}-upload", now=store.clock(), state="failed"))
    part = _put(store, artifacts, folder, f"{owner}{seed} sent".encode())
    asset = add_asset(theirs, asset_row(part, now=store.clock(), fingerprint=part.sha256))[0]
    job = add_job(theirs, asset)
    lease = claim(store, job.id)
    product = _put(store, artifacts, folder, f"{owner}{seed} made".encode())
    file = OutputFile(name="v", media_type="a/b", sha256=product.sha256, bytes=product.bytes)
    start_stage(store, lease, "voxelize")
    publish_stage(store, lease, "voxelize", (file,), key=product.sha256, cached=False, retention_s=1000)
    return job


def _rows(store: Store) -> dict[str, list[dict[str, object]]]:
    with store.reading() as connection:
        return {
            table.name: [
                dict(row._mapping) for row in connection.execute(sa.select(table).order_by(*table.primary_key))
            ]
            for table in t.metadata.sorted_tables
            if table.name not in {"leases", "outbox"}
        }


@pytest.mark.parametrize("into", ["sqlite", "postgresql"])
def test_a_restored_state_has_the_same_rows_and_bytes(store, artifacts, tmp_path, into, request) -> None:
    if into == "postgresql" and store.engine.dialect.name == "postgresql":
        pytest.skip("there is one PostgreSQL")
    jobs = [fill(store, artifacts, tmp_path / "sent", owner) for owner in ("ann", "bob")]
    report = back_up(store, artifacts, tmp_path / "backup")
    assert (report.blobs, report.copied, report.damaged) == (4, 4, ())
    assert back_up(store, artifacts, tmp_path / "backup").copied == 0
    url = f"sqlite:///{tmp_path / 'new.sqlite'}" if into == "sqlite" else request.getfixturevalue("postgres_url")
    other = Store.open(url, clock=store.clock)
    elsewhere = FolderArtifacts(tmp_path / "elsewhere")
    try:
        restore(other, elsewhere, tmp_path / "backup")
        assert _rows(other) == _rows(store)
        read = scrub(other, elsewhere)
        assert (read.blobs, read.missing, read.different) == (4, (), ())
        assert [other.job(job.id) for job in jobs] == [store.job(job.id) for job in jobs]
        lease = claim(other, add_job(other, read_asset(other, jobs[0].asset_id)).id)
        assert succeed(other, lease) == "succeeded"  # numbered rows go on where the backup ended
        with pytest.raises(ConflictError, match="empty"):
            restore(other, elsewhere, tmp_path / "backup")
    finally:
        if into == "postgresql":
            with other.engine.begin() as connection:
                for table in reversed(t.metadata.sorted_tables):
                    connection.execute(table.delete())
        other.close()


def test_a_column_that_went_is_not_restored(store: Store, artifacts: FolderArtifacts, tmp_path: Path) -> None:
    fill(store, artifacts, tmp_path / "sent", "ann")
    back_up(store, artifacts, tmp_path / "backup")
    path = tmp_path / "backup" / "database.jsonl.gz"
    header, *lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    rows = [[name, row | {"gone": 1}] for name, row in map(json.loads, lines)]
    path.write_bytes(gzip.compress("\n".join([header, *map(json.dumps, rows)]).encode()))
    other = Store.open(f"sqlite:///{tmp_path / 'other.sqlite'}", clock=store.clock)
    restore(other, FolderArtifacts(tmp_path / "elsewhere"), tmp_path / "backup")
    assert [job.id for job in other.jobs()] == [job.id for job in store.jobs()] != []
    other.close()


def test_a_backup_is_of_one_moment_while_others_write(store: Store, artifacts: FolderArtifacts, tmp_path: Path) -> None:
    fill(store, artifacts, tmp_path / "sent", "ann")
    stop, wrong = threading.Event(), []

    def write() -> None:
        number = 0
        while not stop.wait(0.005):  # keys are made without end
            try:
                fill(store, artifacts, tmp_path / "more", "bob", seed=str(number := number + 1))
            except ConflictError:  # twenty webhooks are allowed
                continue
            except Exception as error:  # noqa: BLE001 (the test tells)
                wrong.append(error)
                return

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for number in range(3):
            back_up(store, artifacts, tmp_path / str(number))
    finally:
        stop.set()
        writer.join()
    assert not wrong
    for number in range(3):
        other = Store.open(f"sqlite:///{tmp_path / f'{number}.sqlite'}", clock=store.clock)
        elsewhere = FolderArtifacts(tmp_path / f"elsewhere-{number}")
        restore(other, elsewhere, tmp_path / str(number))
        read = scrub(other, elsewhere)
        assert read.blobs
        assert (read.missing, read.different) == ((), ())
        other.close()


def test_one_backup_runs_at_a_time(store: Store, artifacts: FolderArtifacts, tmp_path: Path) -> None:
    assert hold_lease(store, BACKUP_LEASE, owner="other", lease_s=60)
    with pytest.raises(ConflictError, match="another backup"):
        back_up(store, artifacts, tmp_path / "backup")


def test_damaged_bytes_are_found(store: Store, artifacts: FolderArtifacts, tmp_path: Path) -> None:
    fill(store, artifacts, tmp_path / "sent", "ann")
    gone, changed = sorted(path for path in artifacts.root.rglob("*") if path.is_file())
    gone.unlink()
    changed.chmod(0o644)
    changed.write_bytes(b"x" + changed.read_bytes()[1:])
    read = scrub(store, artifacts)
    assert (read.missing, read.different) == ((gone.name,), (changed.name,))
    assert set(back_up(store, artifacts, tmp_path / "backup").damaged) == {gone.name, changed.name}


def test_a_damaged_backup_is_refused(store: Store, artifacts: FolderArtifacts, tmp_path: Path) -> None:
    fill(store, artifacts, tmp_path / "sent", "ann")
    back_up(store, artifacts, tmp_path / "backup")
    other = Store.open(f"sqlite:///{tmp_path / 'new.sqlite'}", clock=store.clock)
    blob = next(path for path in (tmp_path / "backup" / BLOBS).rglob("*") if path.is_file())
    blob.write_bytes(b"other")
    with pytest.raises(BackupError, match="another hash"):
        restore(other, FolderArtifacts(tmp_path / "elsewhere"), tmp_path / "backup")
    (tmp_path / "backup" / "database.jsonl.gz").write_bytes(b"no gzip")
    with pytest.raises(BackupError, match="cannot be read"):
        restore(other, FolderArtifacts(tmp_path / "elsewhere"), tmp_path / "backup")
    with other.reading() as connection:
        assert connection.execute(sa.select(sa.func.count()).select_from(t.jobs)).scalar_one() == 0
    other.close()


def test_an_erased_owner_leaves_nothing(store: Store, artifacts: FolderArtifacts, tmp_path: Path) -> None:
    parts = FolderParts(tmp_path / "parts")
    erased, stays = (fill(store, artifacts, tmp_path / "sent", owner) for owner in ("ann", "bob"))
    (parts.root / "ann-upload").write_bytes(b"private")
    with pytest.raises(ConflictError, match="still run"):
        erase_owner(store, artifacts, parts, "ann")
    finish_cancel(store, Claim(job=replace(store.job(erased.id), attempt=1), owner="worker-1"))
    deleted = erase_owner(store, artifacts, parts, "ann")
    assert deleted == {"keys": 1, "assets": 1, "jobs": 1, "uploads": 1, "webhooks": 1, "blobs": 2}
    assert "ann" not in str(_rows(store))
    assert erased.id not in str(_rows(store))
    contents = {path.read_bytes() for path in artifacts.root.rglob("*") if path.is_file()}
    assert contents == {b"bob sent", b"bob made"}
    assert not list(parts.root.iterdir())
    with pytest.raises(NotFoundError):
        store.job(erased.id)
    assert store.job(stays.id).id == stays.id
    assert scrub(store, artifacts).missing == ()
    assert unreferenced_blobs(store, limit=9) == []


def test_bytes_that_another_owner_has_too_stay(store: Store, artifacts: FolderArtifacts, tmp_path: Path) -> None:
    part = _put(store, artifacts, tmp_path, b"the same tree")
    for owner in ("ann", "bob"):
        row = replace(make_asset(store.clock(), owner[0] * 64), parts=(part,), prepared=part)
        add_asset(store.for_owner(owner), row)
    assert erase_owner(store, artifacts, FolderParts(tmp_path / "parts"), "ann")["blobs"] == 0
    assert artifacts.exists(part.sha256)
