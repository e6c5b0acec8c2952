"""Content-addressed file storage, written once and atomically: a folder on one machine, object storage on many."""

import errno
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import file_digest, sha256
from pathlib import Path
from urllib.parse import unquote, urlsplit

import obstore
from obstore.store import ObjectStore

from jobs.errors import StorageFullError
from jobs.storage.object_storage import REQUEST_PATIENCE_S, open_objects, presigned, reporting_refusals

CHUNK_BYTES = 1024 * 1024
FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Error numbers of the system if a file cannot grow."""


def is_full(error: OSError) -> bool:
    """Return whether the error means that a file cannot grow."""
    return error.errno in FULL


@contextmanager
def _reporting_full_disk() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if not is_full(error):
            raise
        raise StorageFullError(
            f"there is no room in the storage: {error.strerror}; free some, then try again"
        ) from error


class FolderArtifacts:
    """Storage of files by sha256 in a folder; a file is written under a temporary name, synced and renamed.

    Raises:
        FileNotFoundError: no bytes with this hash are stored.
        StorageFullError: the disk is full.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        root.mkdir(mode=0o700, parents=True, exist_ok=True)

    @_reporting_full_disk()
    def put(self, path: Path, digest: str) -> None:
        """Store a file's bytes, unless they are stored already."""
        target = self._path(digest)
        if target.exists():
            return
        target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        beside = target.with_name(f".{digest}.{secrets.token_hex(8)}")
        try:
            _link_or_copy(path, beside)
            beside.chmod(0o444)
            beside.replace(target)
        finally:
            beside.unlink(missing_ok=True)
        _sync(target.parent)

    def read(self, digest: str, *, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Iterate over the bytes from `start` to `stop` in chunks."""
        with self._path(digest).open("rb") as stream:
            stream.seek(start)
            left = (os.fstat(stream.fileno()).st_size if stop is None else stop) - start
            while left > 0 and (chunk := stream.read(min(left, CHUNK_BYTES))):
                left -= len(chunk)
                yield chunk

    def fetch(self, digest: str, path: Path) -> None:
        """Make the bytes readable at a path, by a symbolic link."""
        if not self.exists(digest):
            raise FileNotFoundError(f"no bytes with sha256 {digest}")
        path.unlink(missing_ok=True)
        path.symlink_to(self._path(digest))

    def exists(self, digest: str) -> bool:
        """Return whether the bytes are stored."""
        return self._path(digest).exists()

    def delete(self, digest: str) -> None:
        """Delete the bytes."""
        self._path(digest).unlink(missing_ok=True)

    def link(self, digest: str) -> str | None:
        """Return None, since a folder has no URL."""
        return None

    def free_bytes(self) -> int | None:
        """Return the free space of the folder's disk [bytes]."""
        return shutil.disk_usage(self.root).free

    def _path(self, digest: str) -> Path:
        return self.root / digest[:2] / digest


def _link_or_copy(path: Path, beside: Path) -> None:
    """Hard-link a file if both paths are on one disk, else copy it; the file is not written to after a put."""
    try:
        beside.hardlink_to(path.resolve())
    except OSError as error:
        if error.errno not in {errno.EXDEV, errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP}:
            raise
        shutil.copyfile(path, beside)
    _sync(beside)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class ObjectArtifacts:
    """Storage of files by sha256 in object storage (S3, GCS, Azure, memory). A put is atomic, also a multipart one.

    Raises:
        StorageAwayError: the storage does not respond or refuses the request.
    """

    def __init__(self, objects: ObjectStore) -> None:
        self.objects = objects

    @reporting_refusals()
    def put(self, path: Path, digest: str) -> None:
        """Store a file's bytes."""
        obstore.put(self.objects, _key(digest), path)

    def read(self, digest: str, *, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Iterate over the bytes from `start` to `stop` in chunks."""
        with reporting_refusals():
            end = obstore.head(self.objects, _key(digest))["size"] if stop is None else stop
            if end <= start:
                return
            response = obstore.get(self.objects, _key(digest), options={"range": (start, end)})
            for chunk in response.stream(min_chunk_size=CHUNK_BYTES):
                yield bytes(chunk)

    def fetch(self, digest: str, path: Path) -> None:
        """Make the bytes readable at a path, by a download."""
        with _reporting_full_disk(), path.open("wb") as target:
            target.writelines(self.read(digest))

    @reporting_refusals()
    def exists(self, digest: str) -> bool:
        """Return whether the bytes are stored."""
        try:
            obstore.head(self.objects, _key(digest))
        except FileNotFoundError:
            return False
        return True

    @reporting_refusals()
    def delete(self, digest: str) -> None:
        """Delete the bytes."""
        obstore.delete(self.objects, _key(digest))

    def link(self, digest: str) -> str | None:
        """Return a presigned URL of the bytes in the storage."""
        return presigned(self.objects, "GET", _key(digest))

    def free_bytes(self) -> int | None:
        """Return None, since no limit is known; query an object to detect an unavailable storage."""
        self.exists("0" * 64)
        return None


ArtifactStore = FolderArtifacts | ObjectArtifacts


def open_artifacts(
    url: str, *, patience_s: float = REQUEST_PATIENCE_S, credentials: Mapping[str, str] | None = None
) -> ArtifactStore:
    """Open the store of a URL: `file:///folder`, or object storage as in `open_objects`."""
    parts = urlsplit(url)
    if parts.scheme == "file":
        return FolderArtifacts(Path(unquote(parts.path)))
    return ObjectArtifacts(open_objects(url, patience_s=patience_s, credentials=credentials))


def hash_file(path: Path) -> tuple[str, int]:
    """Return a file's sha256 and size [bytes]."""
    with path.open("rb") as stream:
        return file_digest(stream, "sha256").hexdigest(), stream.tell()


def hash_stored(
    artifacts: ArtifactStore, digest: str, on_chunk: Callable[[bytes], object] = lambda chunk: None
) -> str | None:
    """Compute the sha256 of stored bytes and pass them to `on_chunk`; None if they do not exist."""
    checksum = sha256()
    try:
        for chunk in artifacts.read(digest):
            checksum.update(chunk)
            on_chunk(chunk)
    except FileNotFoundError:
        return None
    return checksum.hexdigest()


def _key(digest: str) -> str:
    return f"{digest[:2]}/{digest}"
