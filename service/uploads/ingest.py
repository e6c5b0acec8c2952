"""Make one asset of uploads that are whole."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from starlette.concurrency import run_in_threadpool

from jobs.errors import ConflictError, GoneError
from jobs.records import AssetRecord
from jobs.storage.artifacts import hash_file
from jobs.storage.assets import read_asset
from jobs.storage.uploads import UploadRecord, change_upload
from jobs.store import new_id
from service.http.multipart import Form, ReceivedFile
from service.http.problems import ProblemError
from service.services import Owned
from service.uploads.intake import admit, sort_out


async def make_asset(
    owned: Owned, uploads: Sequence[UploadRecord], fields: Mapping[str, str]
) -> tuple[AssetRecord, bool]:
    """Make one asset of whole uploads, or give the one that was made of them before; tell whether it is new.

    Raises:
        ConflictError: one is not whole.
        ProblemError: they cannot be used.
    """
    asset_ids = {upload.asset_id for upload in uploads}
    if len(asset_ids) == 1 and None not in asset_ids:
        return await run_in_threadpool(read_asset, owned.store, str(asset_ids.pop())), False
    for upload in uploads:
        if upload.state != "received":
            raise ConflictError(f"upload {upload.id} is {upload.state}; send the rest of it, or begin anew")
    folder = owned.services.settings.scratch_dir / f"ingest-{new_id()}"
    await run_in_threadpool(folder.mkdir, parents=True)
    try:
        form = Form(fields=dict(fields), files=await run_in_threadpool(_files, owned, uploads, folder))
        asset, new = await admit(owned, await run_in_threadpool(sort_out, owned, form, folder), folder)
    finally:
        await run_in_threadpool(shutil.rmtree, folder)
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
            raise ProblemError(
                "checksum-mismatch", f"upload {upload.id} has the sha256 {digest}, not what was promised"
            )
        files.append(ReceivedFile(name=upload.filename, path=path, sha256=digest, bytes=size))
    return files


def _finish(owned: Owned, upload: UploadRecord, asset: AssetRecord) -> None:
    change_upload(owned.store, upload.id, state="ready", asset_id=asset.id, expires_at=asset.expires_at)
    owned.services.upload_parts.delete(upload.id)
