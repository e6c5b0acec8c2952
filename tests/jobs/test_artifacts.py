import os
import threading
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest

from jobs.errors import StorageAwayError, StorageFullError
from jobs.settings import read_settings
from jobs.storage.artifacts import ArtifactStore, FolderArtifacts, hash_file, open_artifacts
from jobs.storage.upload_parts import OBJECT_BYTES, open_parts
from tests.servers import Server, object_storage


@pytest.fixture(params=["folder", "memory"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path) -> ArtifactStore:
    return open_artifacts((tmp_path / "a b").as_uri() if request.param == "folder" else "memory:///")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "source"
    path.write_bytes(bytes(range(256)) * 10_000)
    return path


def test_bytes_come_back_until_they_are_deleted(artifacts: ArtifactStore, source: Path, tmp_path: Path) -> None:
    digest, size = hash_file(source)
    content = source.read_bytes()
    assert not artifacts.exists(digest)
    artifacts.put(source, digest)
    artifacts.put(source, digest)
    assert artifacts.exists(digest)
    assert b"".join(artifacts.read(digest)) == content
    assert b"".join(artifacts.read(digest, start=5, stop=1_500_000)) == content[5:1_500_000]
    assert b"".join(artifacts.read(digest, start=size)) == b""
    artifacts.fetch(digest, tmp_path / "copy")
    assert (tmp_path / "copy").read_bytes() == content
    artifacts.delete(digest)
    artifacts.delete(digest)
    assert not artifacts.exists(digest)
    with pytest.raises(FileNotFoundError):
        artifacts.fetch(digest, tmp_path / "copy")
    with pytest.raises(FileNotFoundError):
        list(artifacts.read(digest))


@pytest.fixture(scope="module")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Server, Path]]:
    """A real S3 server, and the folder in which a file `busy` makes it answer 503."""
    folder = tmp_path_factory.mktemp("s3")
    server, environment = object_storage(folder)
    with pytest.MonkeyPatch.context() as patched:
        for name, value in environment.items():
            patched.setenv(name, value)
        server.start()
        yield server, folder / "objects"
        server.stop()


def test_s3_keeps_what_is_sent_in_parts(s3: tuple[Server, Path], tmp_path: Path) -> None:
    source = tmp_path / "large"
    source.write_bytes(os.urandom(12_000_000))  # three parts
    artifacts = open_artifacts("s3://trees/products")
    digest, _ = hash_file(source)
    artifacts.put(source, digest)
    assert sha256(b"".join(artifacts.read(digest))).hexdigest() == digest
    assert b"".join(artifacts.read(digest, start=5_000_000, stop=5_500_000)) == source.read_bytes()[5_000_000:5_500_000]
    artifacts.delete(digest)
    assert not artifacts.exists(digest)


def test_key_and_secret_may_be_settings(s3, source, monkeypatch, tmp_path) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    (tmp_path / "dynamictree_database_url").write_text("postgresql://tree@host/jobs")
    (tmp_path / "dynamictree_s3_access_key_id").write_text("tree:tree")
    (tmp_path / "dynamictree_s3_secret_access_key").write_text("secret")
    monkeypatch.setenv("DYNAMICTREE_SECRETS_DIR", str(tmp_path))
    settings = read_settings()
    assert "secret'" not in repr(settings)
    assert settings.resolved_database_url == "postgresql://tree@host/jobs"
    digest, _ = hash_file(source)
    artifacts = open_artifacts("s3://trees/products", credentials=settings.s3_credentials)
    artifacts.put(source, digest)
    assert artifacts.exists(digest)
    assert open_parts("s3://trees/products", credentials=settings.s3_credentials).size("none") == 0


def test_pieces_in_s3_make_the_upload(s3: tuple[Server, Path], tmp_path: Path) -> None:
    parts = open_parts("s3://trees/products")
    writer = parts.writer("one", 0)
    writer.write([b"some", b"thing"])
    writer.keep()
    last = parts.writer("one", 9)
    last.write([b" more"])
    last.keep()
    assert parts.size("one") == 14
    parts.fetch("one", tmp_path / "whole")
    assert (tmp_path / "whole").read_bytes() == b"something more"
    parts.delete("one")
    parts.delete("one")
    assert parts.size("one") == 0


def test_of_two_replicas_that_write_one_upload_one_is_refused(s3: tuple[Server, Path], tmp_path: Path) -> None:
    """The late one, with an older connection's bytes, puts nothing over what was reported as received."""
    early, late = (open_parts("s3://trees/products") for _ in range(2))
    slow = early.writer("both", 0)
    slow.write([b"old"])
    quick = late.writer("both", 0)
    quick.write([b"something", bytes(OBJECT_BYTES)])
    quick.write([b"more"])
    quick.keep()
    with pytest.raises(BlockingIOError, match="at 0"):
        slow.keep()
    slow.keep()
    assert late.size("both") == 9 + OBJECT_BYTES + 4
    late.fetch("both", tmp_path / "whole")
    assert (tmp_path / "whole").read_bytes().startswith(b"something\0")
    late.delete("both")


def test_a_busy_storage_is_waited_for_as_long_as_configured(s3: tuple[Server, Path], source: Path) -> None:
    digest, _ = hash_file(source)
    busy = s3[1] / "busy"
    busy.touch()
    with pytest.raises(StorageAwayError, match="object storage"):
        open_artifacts("s3://trees/products", patience_s=0.2).put(source, digest)
    threading.Timer(0.6, busy.unlink).start()
    artifacts = open_artifacts("s3://trees/products", patience_s=60)
    artifacts.put(source, digest)
    assert artifacts.exists(digest)


def test_a_storage_that_is_down_or_refuses_us_is_reported(s3, source, monkeypatch, tmp_path) -> None:
    digest, _ = hash_file(source)
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "wrong")
    artifacts, parts = open_artifacts("s3://trees/products"), open_parts("s3://trees/products")
    writer = parts.writer("one", 0)
    writer.write([b"something"])
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    down = open_artifacts("s3://trees/products", patience_s=0.2)
    for ask in (
        lambda: artifacts.exists(digest),
        writer.keep,
        lambda: parts.size("one"),
        lambda: parts.delete("one"),
        lambda: parts.fetch("one", tmp_path / "whole"),
        lambda: down.exists(digest),
        lambda: down.delete(digest),
        lambda: list(down.read(digest)),
    ):
        with pytest.raises(StorageAwayError):
            ask()


def test_a_full_disk_leaves_nothing_and_is_reported(small_disk: Path, source: Path) -> None:
    digest, _ = hash_file(source)
    (small_disk / "rest").write_bytes(bytes(63 * 1024**2))
    artifacts = FolderArtifacts(small_disk / "artifacts")
    with pytest.raises(StorageFullError, match="no room in the storage: No space left on device"):
        artifacts.put(source, digest)
    assert [path for path in artifacts.root.rglob("*") if path.is_file()] == []
