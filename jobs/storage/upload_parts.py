"""Bytes of incomplete uploads, in a folder or in object storage. Written bytes are never lost."""

import fcntl
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote, urlsplit

import obstore
from obstore.exceptions import AlreadyExistsError
from obstore.store import ObjectStore

from jobs.storage.object_storage import open_objects, presigned, reporting_refusals

PREFIX = "uploads"
SYNC_BYTES = 64 * 1024**2
"""Bytes between two syncs of a file, so that the last sync is short and dirty pages are few."""

OBJECT_BYTES = 16 * 1024**2
"""Size of the objects that an upload is stored in."""

CHUNK_BYTES = 4 * 1024**2


class FolderParts:
    """Storage of incomplete uploads in a folder, one file per upload; its length is the number of bytes received."""

    def __init__(self, root: Path) -> None:
        self.root = root
        root.mkdir(mode=0o700, parents=True, exist_ok=True)

    def size(self, upload_id: str) -> int:
        """Return the number of bytes received."""
        path = self.root / upload_id
        return path.stat().st_size if path.exists() else 0

    def writer(self, upload_id: str, offset: int) -> "FileWriter":
        """Open the upload for appending at a byte offset."""
        return FileWriter(self.root / upload_id, offset)

    def link(self, upload_id: str, offset: int) -> str | None:
        """Return None, since a folder has no URL."""
        return None

    def fetch(self, upload_id: str, path: Path) -> None:
        """Make the upload readable at a path, by a hard link."""
        path.hardlink_to(self.root / upload_id)

    def delete(self, upload_id: str) -> None:
        """Delete the upload."""
        (self.root / upload_id).unlink(missing_ok=True)


class FileWriter:
    """Exclusive writer that appends to a file.

    Raises:
        BlockingIOError: another writer has the file.
    """

    def __init__(self, path: Path, offset: int) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT, 0o600)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise
        self._unsynced = 0
        os.lseek(self._descriptor, offset, os.SEEK_SET)

    def write(self, chunks: Sequence[bytes]) -> None:
        """Append chunks."""
        for chunk in chunks:
            view = memoryview(chunk)
            while view:
                view = view[os.write(self._descriptor, view) :]
        self._unsynced += sum(map(len, chunks))
        if self._unsynced >= SYNC_BYTES:
            os.fdatasync(self._descriptor)
            self._unsynced = 0

    def keep(self) -> None:
        """Sync and close the file."""
        try:
            os.fdatasync(self._descriptor)
        finally:
            os.close(self._descriptor)


class ObjectParts:
    """Storage of incomplete uploads as objects, each named by the offset of its first byte. A put is atomic.

    Raises:
        StorageAwayError: the storage does not respond or refuses the request.
    """

    def __init__(self, objects: ObjectStore) -> None:
        self.objects = objects

    def size(self, upload_id: str) -> int:
        """Return the number of bytes received without a gap."""
        return sum(size for _, size in self._parts(upload_id))

    def writer(self, upload_id: str, offset: int) -> "ObjectWriter":
        """Open the upload for appending at a byte offset."""
        return ObjectWriter(self.objects, upload_id, offset)

    def link(self, upload_id: str, offset: int) -> str | None:
        """Return a presigned URL to PUT the bytes from `offset` on."""
        return presigned(self.objects, "PUT", _key(upload_id, offset))

    def fetch(self, upload_id: str, path: Path) -> None:
        """Make the upload readable at a path, by a download."""
        with path.open("xb") as target, reporting_refusals():
            for key, _ in self._parts(upload_id):
                for chunk in obstore.get(self.objects, key).stream(min_chunk_size=CHUNK_BYTES):
                    target.write(bytes(chunk))

    @reporting_refusals()
    def delete(self, upload_id: str) -> None:
        """Delete the upload."""
        keys = [key for key, _ in self._listed(upload_id)]
        if keys:
            obstore.delete(self.objects, keys)

    def _parts(self, upload_id: str) -> list[tuple[str, int]]:
        entries = []
        end = 0
        for key, size in self._listed(upload_id):
            if int(key.rpartition("/")[2]) != end:
                break
            entries.append((key, size))
            end += size
        return entries

    @reporting_refusals()
    def _listed(self, upload_id: str) -> list[tuple[str, int]]:
        pages = obstore.list(self.objects, prefix=f"{PREFIX}/{upload_id}")
        return sorted((str(meta["path"]), int(meta["size"])) for page in pages for meta in page)


class ObjectWriter:
    """Writer that puts an object whenever it has enough bytes, and never overwrites one.

    Two replicas may write the same upload if a client repeats a request that is still running. The first to put the
    object of an offset wins; the other one is refused, and its client queries the offset again.

    Raises:
        BlockingIOError: another writer has put the object of this offset.
    """

    def __init__(self, objects: ObjectStore, upload_id: str, offset: int) -> None:
        self._objects = objects
        self._upload_id = upload_id
        self._offset = offset
        self._waiting = bytearray()

    def write(self, chunks: Sequence[bytes]) -> None:
        """Append chunks."""
        for chunk in chunks:
            self._waiting += chunk
        if len(self._waiting) >= OBJECT_BYTES:
            self._put()

    def keep(self) -> None:
        """Put the remaining bytes."""
        if self._waiting:
            self._put()

    def _put(self) -> None:
        key = _key(self._upload_id, self._offset)
        content = bytes(self._waiting)
        self._waiting.clear()
        with reporting_refusals():
            try:
                obstore.put(self._objects, key, content, mode="create")
            except AlreadyExistsError as error:
                raise BlockingIOError(f"another request has written the upload at {self._offset:,}") from error
        self._offset += len(content)


def _key(upload_id: str, offset: int) -> str:
    return f"{PREFIX}/{upload_id}/{offset:020d}"


PartStore = FolderParts | ObjectParts
PartWriter = FileWriter | ObjectWriter


def open_parts(artifacts_url: str, *, credentials: Mapping[str, str] | None = None) -> PartStore:
    """Open the store of upload parts beside the artefacts: in their folder, or in their bucket."""
    parts = urlsplit(artifacts_url)
    if parts.scheme == "file":
        return FolderParts(Path(unquote(parts.path)) / PREFIX)
    return ObjectParts(open_objects(artifacts_url, credentials=credentials))
