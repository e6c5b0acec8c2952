"""Append the body of one PATCH to an upload. Received bytes stay; one request writes at a time."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import sqlalchemy as sa
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from jobs.errors import GoneError, NotFoundError
from jobs.records import UploadRecord
from jobs.storage.artifacts import is_full
from jobs.storage.upload_parts import PartStore, PartWriter
from jobs.storage.uploads import change_upload, upload
from jobs.store import Store, new_id
from service.http.problems import ProblemError
from service.services import Owned
from service.uploads.batches import write_in_batches

POLL_S = 0.5
"""Interval at which a request checks whether a newer one has taken over the upload [s]."""

TAKE_OVER_S = 5.0
"""Time that a newer request waits for the older one to store its bytes [s]."""


async def append(owned: Owned, record: UploadRecord, body: AsyncIterator[bytes], offset: int) -> int:
    """Append a body to an upload, taking over from an older request that still writes; return the new size.

    Raises:
        ProblemError: the offset is wrong, there are too many bytes or no room, or a newer request took over.
    """
    parts, token = owned.services.upload_parts, new_id()
    await run_in_threadpool(change_upload, owned.store, record.id, was=("receiving",), writer=token)
    writer = await _open(parts, record.id, offset)
    try:
        async with _while_writer(owned.store, parts, record.id, token):
            try:
                return offset + await write_in_batches(_checked(owned, record, body, offset), writer.write)
            finally:
                await asyncio.shield(run_in_threadpool(writer.keep))
    except ClientDisconnect:
        raise ProblemError("bad-request", "the connection broke before the body was whole; go on with it") from None
    except OSError as error:
        if isinstance(error, BlockingIOError):
            raise _superseded(record.id) from error
        if is_full(error):
            raise ProblemError("disk-full", "the disk is full; bytes received so far are stored") from error
        raise


def wrong_offset(offset: int, size: int) -> ProblemError:
    """Return the problem of bytes that do not begin at the upload's offset."""
    reason = f"Upload-Offset is {offset:,}, the upload stands at {size:,}"
    return ProblemError("upload-offset-conflict", reason, headers={"Upload-Offset": str(size)})


def _superseded(upload_id: str) -> ProblemError:
    return ProblemError("conflict", f"another request goes on with upload {upload_id}")


async def _open(parts: PartStore, upload_id: str, offset: int) -> PartWriter:
    """Open the upload's only writer; wait until the older request has stored its bytes."""
    deadline = time.monotonic() + TAKE_OVER_S
    while True:
        try:
            writer = await run_in_threadpool(lambda: parts.writer(upload_id, offset))
        except BlockingIOError as error:
            if time.monotonic() > deadline:
                raise ProblemError("conflict", f"another request writes upload {upload_id}; try again") from error
            await asyncio.sleep(0.05)
            continue
        size = await run_in_threadpool(parts.size, upload_id)
        if size != offset:
            await run_in_threadpool(writer.keep)
            raise wrong_offset(offset, size)
        return writer


@asynccontextmanager
async def _while_writer(store: Store, parts: PartStore, upload_id: str, token: str) -> AsyncIterator[None]:
    """Context manager that ends its block with a ProblemError once the upload has another writer, or is deleted."""
    block = asyncio.current_task()
    assert block is not None
    taken_over = False

    async def watch() -> None:
        nonlocal taken_over
        while await run_in_threadpool(_is_writer, store, upload_id, token):
            await asyncio.sleep(POLL_S)
        taken_over = True
        block.cancel()

    watching = asyncio.create_task(watch())
    try:
        yield
    except asyncio.CancelledError:
        if not taken_over:
            raise
        block.uncancel()
        await run_in_threadpool(_clear_deleted, store, parts, upload_id)
        raise _superseded(upload_id) from None
    finally:
        watching.cancel()


def _is_writer(store: Store, upload_id: str, token: str) -> bool:
    try:
        return upload(store, upload_id).writer == token
    except (NotFoundError, GoneError):
        return False
    except sa.exc.SQLAlchemyError:
        return True  # the database is unavailable: check again later


def _clear_deleted(store: Store, parts: PartStore, upload_id: str) -> None:
    """Delete the bytes that an upload received after it was deleted."""
    try:
        upload(store, upload_id)
    except (NotFoundError, GoneError):
        parts.delete(upload_id)


async def _checked(owned: Owned, record: UploadRecord, body: AsyncIterator[bytes], offset: int) -> AsyncIterator[bytes]:
    """Iterate over the body; refuse bytes beyond the announced length."""
    assert record.length is not None
    size = offset
    async for chunk in body:
        if chunk and not size:
            until = owned.store.clock() + owned.services.settings.upload_retention_s
            await run_in_threadpool(change_upload, owned.store, record.id, expires_at=until)
        size += len(chunk)
        if size > record.length:
            detail = f"the upload has {record.length:,} bytes as announced, and more were sent"
            raise ProblemError("payload-too-large", detail, headers={"Connection": "close"})
        yield chunk
