"""Turn uploads into assets: on request, or in the background for URLs and `asset=auto`."""

import asyncio
import logging
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

import sqlalchemy as sa
from starlette.concurrency import run_in_threadpool

from jobs.errors import ConflictError, GoneError, OutboundError
from jobs.records import AssetRecord, Limit, UploadRecord
from jobs.storage.artifacts import hash_file
from jobs.storage.assets import read_asset
from jobs.storage.uploads import change_upload, claim_uploads
from service.http.caller import Caller
from service.http.multipart import ReceivedFile
from service.http.problems import REFUSALS, ProblemError, problem_of
from service.schemas.assets import AssetOptions
from service.services import Owned, Services
from service.uploads.batches import write_in_batches
from service.uploads.intake import parse_and_store, scratch_folder
from service.uploads.quota import require_space

logger = logging.getLogger(__name__)

BYTES_ALLOWED = "bytes_allowed"
"""Option of an upload from a URL: the quota of the key that requested it."""

LEASE_S = 60.0
POLL_S = 5.0
CHUNK_BYTES = 1024**2


async def make_asset(owned: Owned, uploads: Sequence[UploadRecord], options: AssetOptions) -> tuple[AssetRecord, bool]:
    """Make an asset from complete uploads, or return the one made before; the second value is whether it is new."""
    asset_ids = {upload.asset_id for upload in uploads}
    if len(asset_ids) == 1 and None not in asset_ids:
        return await run_in_threadpool(read_asset, owned.store, str(asset_ids.pop())), False
    for upload in uploads:
        if upload.state not in {"received", "failed"} or upload.length is None:
            raise ConflictError(f"upload {upload.id} is {upload.state}; send the rest of it, or begin anew")
    async with scratch_folder(owned) as folder:
        files = await run_in_threadpool(_files, owned, uploads, folder)
        asset, new = await parse_and_store(owned, options, files, folder)
    for upload in uploads:
        await run_in_threadpool(_finish, owned, upload, asset)
    return asset, new


def _files(owned: Owned, uploads: Sequence[UploadRecord], folder: Path) -> list[ReceivedFile]:
    files = []
    for number, upload in enumerate(uploads):
        path = folder / f"part-{number}"
        try:
            owned.services.upload_parts.fetch(upload.id, path)
        except FileNotFoundError as error:
            raise GoneError(f"the bytes of upload {upload.id} were removed; begin it anew") from error
        digest, size = hash_file(path)
        if size != upload.length or upload.sha256 not in {None, digest}:
            detail = f"upload {upload.id} has the sha256 {digest}, not what was promised"
            raise ProblemError("checksum-mismatch", detail)
        files.append(ReceivedFile(name=upload.filename, path=path, sha256=digest, bytes=size))
    return files


def _finish(owned: Owned, upload: UploadRecord, asset: AssetRecord) -> None:
    change_upload(
        owned.store,
        upload.id,
        state="ready",
        asset_id=asset.id,
        error_code=None,
        error_message=None,
        expires_at=asset.expires_at,
    )
    owned.services.upload_parts.delete(upload.id)


class Ingest:
    """Background task that fetches URLs and makes assets. A lease in the store assigns each upload to one process."""

    def __init__(self, services: Services) -> None:
        self.services = services
        self._running: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Look for work until cancelled."""
        try:
            while True:
                await self._look()
                try:
                    async with asyncio.timeout(POLL_S):
                        await self.services.ingest_wakeup.wait()
                except TimeoutError:
                    continue
        finally:
            for task in self._running:
                task.cancel()
            await asyncio.gather(*self._running, return_exceptions=True)

    async def _look(self) -> None:
        self.services.ingest_wakeup.clear()
        room = self.services.settings.max_fetches - len(self._running)
        if room <= 0:
            return
        try:
            share = self.services.settings.share_of(self.services.settings.max_fetches)
            claimed = await run_in_threadpool(
                claim_uploads, self.services.store, lease_s=LEASE_S, limit=room, per_owner=share
            )
        except sa.exc.SQLAlchemyError as error:
            logger.warning("uploads cannot be looked for: %s", error)
            return
        for upload in claimed:
            task = asyncio.create_task(self._work(upload))
            self._running.add(task)
            task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._running.discard(task)
        self.services.ingest_wakeup.set()
        if not task.cancelled() and (error := task.exception()) is not None:
            logger.error("an upload was left; its lease will run out", exc_info=error)

    async def _work(self, upload: UploadRecord) -> None:
        allowed = upload.options.get(BYTES_ALLOWED)
        limits: dict[Limit, int] = {"bytes": allowed} if isinstance(allowed, int) else {}
        owned = self.services.owned_by(Caller(owner=upload.owner, limits=limits))
        renewing = asyncio.create_task(self._renew(upload.id))
        try:
            if upload.state == "fetching":
                upload = await fetch(owned, upload)
            own = {name: value for name, value in upload.options.items() if name in AssetOptions.model_fields}
            await make_asset(owned, [upload], AssetOptions.read(own, where="metadata"))
        except (*REFUSALS, OSError) as error:
            problem = problem_of(error)
            if upload.state == "fetching":
                await run_in_threadpool(owned.services.upload_parts.delete, upload.id)  # a later fetch starts over
            await run_in_threadpool(
                change_upload,
                owned.store,
                upload.id,
                state="failed",
                error_code=problem.code,
                error_message=problem.detail,
                make_asset=False,
            )
        finally:
            renewing.cancel()

    async def _renew(self, upload_id: str) -> None:
        while True:
            await asyncio.sleep(LEASE_S / 3)
            until = self.services.store.clock() + LEASE_S
            await run_in_threadpool(change_upload, self.services.store, upload_id, lease_until=until)


async def fetch(owned: Owned, upload: UploadRecord) -> UploadRecord:
    """Fetch an upload's bytes from its URL."""
    settings = owned.services.settings
    assert upload.source_url is not None
    parts = owned.services.upload_parts
    await run_in_threadpool(parts.delete, upload.id)
    writer = await run_in_threadpool(lambda: parts.writer(upload.id, 0))

    def write(batch: list[bytes]) -> None:
        require_space(owned, sum(map(len, batch)))
        writer.write(batch)

    try:
        async with asyncio.timeout(settings.fetch_time_s), owned.services.outbound.get(upload.source_url) as response:
            if response.headers.get("content-encoding", "identity") != "identity":
                raise OutboundError("the address sends a packed body though it was asked not to")
            await run_in_threadpool(require_space, owned, _bytes_of(response.headers.get("content-length", "0")))
            body = _bounded(response.aiter_raw(CHUNK_BYTES), settings.max_upload_bytes)
            size = await write_in_batches(body, write)
    except TimeoutError as error:
        raise OutboundError(f"the file did not come within {settings.fetch_time_s:g} s") from error
    finally:
        await asyncio.shield(run_in_threadpool(writer.keep))
    return await run_in_threadpool(
        change_upload, owned.store, upload.id, was=("fetching",), state="received", length=size, received=size
    )


async def _bounded(body: AsyncIterator[bytes], allowed: int) -> AsyncIterator[bytes]:
    size = 0
    async for chunk in body:
        size += len(chunk)
        if size > allowed:
            raise ProblemError("payload-too-large", f"the file has more than the {allowed:,} bytes that are allowed")
        yield chunk


def _bytes_of(length: str) -> int:
    return int(length) if length.isascii() and length.isdecimal() and len(length) <= 18 else 0
