"""Append the body of one PATCH to an upload. Received bytes stay; one request writes at a time."""

import asyncio
import base64
import binascii
import hashlib
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Self

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from jobs.storage.artifacts import is_full
from jobs.storage.upload_parts import PartStore, PartWriter
from jobs.storage.uploads import UploadRecord, change_upload, upload
from jobs.store import Store
from service.http.problems import ProblemError

BATCH_BYTES = 4 * 1024**2
"""So much is handed to a thread at once; two batches at most are in memory."""

LOOK_S = 0.5
"""How often a request asks whether another one has taken over, which matters where there are several replicas."""

TAKE_OVER_S = 5.0
CHECKSUMS = ("sha1", "sha256")
"""Algorithms of `Upload-Checksum`. A server of tus' checksum extension has to know sha1, which common clients send."""


@dataclass(frozen=True)
class Checksum:
    """What a client declares of the bytes of one PATCH."""

    algorithm: str
    expected: bytes

    @classmethod
    def of_header(cls, header: str | None) -> Self | None:
        """Value of `Upload-Checksum`; None without that header.

        Raises:
            ProblemError: it cannot be read, or is of another algorithm.
        """
        if header is None:
            return None
        algorithm, _, encoded = header.strip().partition(" ")
        if algorithm not in CHECKSUMS:
            raise ProblemError("bad-request", f"Upload-Checksum names {algorithm!r}; {', '.join(CHECKSUMS)} are known")
        try:
            return cls(algorithm, base64.b64decode(encoded, validate=True))
        except (binascii.Error, ValueError) as error:
            raise ProblemError("bad-request", "Upload-Checksum is not an algorithm and base64") from error


def stands_elsewhere(offset: int, size: int) -> ProblemError:
    """Problem for bytes that do not begin at the upload's offset."""
    reason = f"Upload-Offset is {offset:,}, the upload stands at {size:,}"
    return ProblemError("upload-offset-conflict", reason, headers={"Upload-Offset": str(size)})


class UploadWriter:
    """Appends the body of one request to one upload."""

    def __init__(
        self, store: Store, parts: PartStore, record: UploadRecord, checksum: Checksum | None, *, retention_s: float
    ) -> None:
        assert record.length is not None
        self.store = store
        self.parts = parts
        self.record = record
        self.length = record.length
        self.checksum = checksum
        self.retention_s = retention_s
        self.token = hashlib.sha256(f"{record.id}{time.monotonic_ns()}{id(self)}".encode()).hexdigest()
        self.digest = None if checksum is None else hashlib.new(checksum.algorithm)

    async def append(self, body: AsyncIterator[bytes], offset: int) -> int:
        """Write the body; keep or discard it at the end."""
        await run_in_threadpool(change_upload, self.store, self.record.id, was=("receiving",), writer=self.token)
        writer = await self._open(offset)
        size, whole = offset, False
        try:
            size = await self._write_all(writer, body, offset)
            whole = True
        except ClientDisconnect:
            raise ProblemError("bad-request", "the connection broke before the body was whole; go on with it") from None
        except BlockingIOError as error:
            raise ProblemError("conflict", f"another request goes on with upload {self.record.id}") from error
        except OSError as error:
            if is_full(error):
                raise ProblemError("disk-full", "the disk is full; bytes received so far are stored") from error
            raise
        finally:
            await asyncio.shield(self._close(writer, whole))
        return size

    async def _open(self, offset: int) -> PartWriter:
        deadline = time.monotonic() + TAKE_OVER_S
        while True:
            size = await run_in_threadpool(self.parts.size, self.record.id)
            if size != offset:
                raise stands_elsewhere(offset, size)
            try:
                return await run_in_threadpool(self.parts.writer, self.record.id, offset)
            except BlockingIOError as error:
                if time.monotonic() > deadline:
                    reason = f"another request writes upload {self.record.id}; try again"
                    raise ProblemError("conflict", reason) from error
                await asyncio.sleep(0.05)

    async def _write_all(self, writer: PartWriter, body: AsyncIterator[bytes], offset: int) -> int:
        """While a thread writes one batch, the next one comes in."""
        batch: list[bytes] = []
        unwritten, size, look_at = 0, offset, time.monotonic() + LOOK_S
        writing: asyncio.Future[None] | None = None
        loop = asyncio.get_running_loop()
        try:
            async for chunk in body:
                if chunk and not (size or unwritten):
                    await self._stay()
                unwritten += len(chunk)
                if size + unwritten > self.length:
                    detail = f"the upload has {self.length:,} bytes as announced, and more were sent"
                    raise ProblemError("payload-too-large", detail, headers={"Connection": "close"})
                batch.append(chunk)
                if unwritten < BATCH_BYTES:
                    continue
                if writing is not None:
                    await writing
                writing = loop.run_in_executor(None, self._write, writer, batch)
                batch, size, unwritten = [], size + unwritten, 0
                if time.monotonic() >= look_at:
                    await self._require_ours()
                    look_at = time.monotonic() + LOOK_S
        finally:
            if writing is not None:
                await writing
            if batch and size + unwritten <= self.length:
                await loop.run_in_executor(None, self._write, writer, batch)
                size += unwritten
        return size

    def _write(self, writer: PartWriter, batch: list[bytes]) -> None:
        writer.write(batch)
        if self.digest is not None:
            for chunk in batch:
                self.digest.update(chunk)

    async def _stay(self) -> None:
        """With its first byte, an upload stays longer than one that was only announced."""
        until = self.store.clock() + self.retention_s
        await run_in_threadpool(change_upload, self.store, self.record.id, expires_at=until)

    async def _require_ours(self) -> None:
        now = await run_in_threadpool(upload, self.store, self.record.id)
        if now.writer != self.token:
            raise ProblemError("conflict", f"another request goes on with upload {self.record.id}")

    async def _close(self, writer: PartWriter, whole: bool) -> None:
        checked = self.digest is None or self.checksum is None
        if checked or (whole and self.digest.digest() == self.checksum.expected):  # type: ignore[union-attr]
            try:
                await run_in_threadpool(writer.keep)
            except BlockingIOError as error:
                raise ProblemError("conflict", f"another request goes on with upload {self.record.id}") from error
            return
        await run_in_threadpool(writer.discard)
        if whole:
            raise ProblemError("checksum-mismatch", "the checksum of these bytes is another; they were dropped")


@dataclass
class ActiveWriters:
    """Requests of this process that are writing to an upload, so that a newer one can end an older one."""

    writing: dict[str, asyncio.Task[object]] = field(default_factory=dict)
    superseded: set[asyncio.Task[object]] = field(default_factory=set)

    async def take_over(self, upload_id: str) -> None:
        """End an older request to the same upload, and wait until it has stored its bytes."""
        deadline = time.monotonic() + TAKE_OVER_S
        older = self.writing.get(upload_id)
        if older is not None and older not in self.superseded:
            self.superseded.add(older)
            older.cancel()
        while upload_id in self.writing and time.monotonic() < deadline:
            await asyncio.sleep(0.01)

    async def append(self, writer: UploadWriter, body: AsyncIterator[bytes], offset: int) -> int:
        """Append a body to an upload, instead of an older request that still writes; return the new size.

        Raises:
            ProblemError: wrong offset, too many bytes, another checksum, or a newer request took over.
        """
        upload_id, task = writer.record.id, asyncio.current_task()
        assert task is not None
        await self.take_over(upload_id)
        self.writing[upload_id] = task
        try:
            return await writer.append(body, offset)
        except asyncio.CancelledError:
            if task not in self.superseded:
                raise
            task.uncancel()
            raise ProblemError("conflict", f"another request goes on with upload {upload_id}") from None
        finally:
            self.superseded.discard(task)
            if self.writing.get(upload_id) is task:
                del self.writing[upload_id]
