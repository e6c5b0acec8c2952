from pathlib import Path

import pytest

from jobs.artifacts import ArtifactStore, hash_file, open_artifacts


@pytest.fixture(params=["folder", "memory"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path) -> ArtifactStore:
    return open_artifacts((tmp_path / "a b").as_uri() if request.param == "folder" else "memory:///")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "source"
    path.write_bytes(bytes(range(256)) * 10_000)
    return path


def test_bytes_come_back_whole_and_in_part(artifacts: ArtifactStore, source: Path, tmp_path: Path) -> None:
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


def test_deleted_bytes_are_gone(artifacts: ArtifactStore, source: Path, tmp_path: Path) -> None:
    digest, _ = hash_file(source)
    artifacts.put(source, digest)
    artifacts.delete(digest)
    artifacts.delete(digest)
    assert not artifacts.exists(digest)
    with pytest.raises(FileNotFoundError):
        artifacts.fetch(digest, tmp_path / "copy")
    with pytest.raises(FileNotFoundError):
        list(artifacts.read(digest))


def test_a_put_that_fails_leaves_nothing(tmp_path: Path) -> None:
    artifacts = open_artifacts((tmp_path / "store").as_uri())
    with pytest.raises(FileNotFoundError):
        artifacts.put(tmp_path / "absent", "e" * 64)
    assert [path for path in (tmp_path / "store").rglob("*") if path.is_file()] == []


def test_free_bytes_are_those_of_the_disk(artifacts: ArtifactStore) -> None:
    free = artifacts.free_bytes()
    assert free is None or free > 0
