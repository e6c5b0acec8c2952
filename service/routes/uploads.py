"""/v1/uploads: resumable uploads by the tus protocol, version 1.0; see docs/uploads.md."""

import asyncio
import base64
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from email.utils import formatdate
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response
from starlette.concurrency import run_in_threadpool

from jobs.errors import ConflictError
from jobs.records import UploadRecord
from jobs.storage.artifacts import hash_file
from jobs.storage.object_storage import LINK_S
from jobs.storage.uploads import change_upload, delete_upload, upload
from service.http.middleware import TUS_VERSION
from service.http.problems import ProblemError, wrong_field
from service.http.request_headers import WaitS
from service.http.routing import Id, headers, refusals
from service.schemas.assets import UploadMetadata, UploadPartPayload, UploadPartsPayload, UploadPayload, upload_payload
from service.services import Owned, OwnedDep
from service.uploads.append import append, wrong_offset
from service.uploads.quota import announce_upload, require_room

router = APIRouter(prefix="/v1/uploads", tags=["uploads"])

EXTENSIONS = ("creation", "creation-with-upload", "expiration", "termination")
CONTENT_TYPE = "application/offset+octet-stream"
MAX_METADATA_CHARS = 8192
PART_BYTES = 64 * 1024**2
"""Size of the part per presigned URL: 64 parts are an upload of 4 GiB."""

_POLL_S = 0.25

_Version = Annotated[str | None, Header(alias="Tus-Resumable", description="Version of tus: 1.0.0")]
_BODY = {
    "content": {CONTENT_TYPE: {"schema": {"type": "string", "format": "binary"}}},
    "description": "Bytes from Upload-Offset on",
}
_BYTES_BODY: dict[str, Any] = {"response_class": Response, "openapi_extra": {"requestBody": _BODY}}
_OFFSET_HEADERS = headers(
    Upload_Offset="bytes received", Upload_Expires="time of deletion if no more bytes arrive", Tus_Resumable="1.0.0"
)
_ERRORS = ("precondition-failed", "unsupported-format", "conflict", "checksum-mismatch", "request-timeout", "disk-full")


@router.options("", status_code=204, responses=refusals())
async def get_upload_protocol(owned: OwnedDep) -> Response:
    """Return the supported versions and extensions of tus."""
    protocol_headers = {
        "Tus-Version": TUS_VERSION,
        "Tus-Extension": ",".join(EXTENSIONS),
        "Tus-Max-Size": str(owned.services.settings.max_upload_bytes),
    }
    return Response(status_code=204, headers=protocol_headers)


@router.post(
    "",
    status_code=201,
    **_BYTES_BODY,
    responses=refusals("invalid-input", "quota-exceeded", *_ERRORS)
    | {201: {"description": "Created", **headers(Location="URL of the upload", Upload_Offset="bytes received")}},
)
async def create_upload(
    request: Request,
    owned: OwnedDep,
    tus_resumable: _Version = None,
    upload_length: Annotated[str | None, Header(description="Size of the file [bytes]")] = None,
    upload_metadata: Annotated[
        str | None,
        Header(description="Pairs of name and base64: filename, kind, sha256, up_axis, unit_m, metadata, asset (auto)"),
    ] = None,
    content_type: Annotated[str | None, Header()] = None,
) -> Response:
    """Create an upload; the request may contain its first bytes."""
    _require_version(tus_resumable)
    length = _length(upload_length, owned)
    metadata = _metadata(upload_metadata)
    with_bytes = content_type is not None and content_type.partition(";")[0].strip() == CONTENT_TYPE
    record = await run_in_threadpool(
        announce_upload,
        owned,
        owned.services.settings.upload_begin_s,
        state="receiving",
        filename=metadata.filename or metadata.name or "file",
        options=metadata.stored() | {"sent": upload_metadata or ""},
        length=length,
        sha256=metadata.sha256,
        make_asset=metadata.asset == "auto",
    )
    if with_bytes:
        record = await _append(owned, record, request.stream(), 0)
    return Response(status_code=201, headers=_offset_headers(record) | {"Location": f"/v1/uploads/{record.id}"})


@router.head(
    "/{id}",
    response_class=Response,
    responses=refusals("not-found", "expired", "precondition-failed")
    | {200: {"description": "Current offset", **_OFFSET_HEADERS}},
)
def head_upload(id: Id, owned: OwnedDep, tus_resumable: _Version = None) -> Response:
    """Return the current offset of an upload."""
    _require_version(tus_resumable)
    record = _with_size(owned, upload(owned.store, id))
    sent = _offset_headers(record) | {"Cache-Control": "no-store"}
    if record.length is not None:
        sent["Upload-Length"] = str(record.length)
    if record.options.get("sent"):
        sent["Upload-Metadata"] = str(record.options["sent"])
    return Response(headers=sent)


@router.patch(
    "/{id}",
    status_code=204,
    **_BYTES_BODY,
    responses=refusals("not-found", "expired", "upload-offset-conflict", *_ERRORS)
    | {204: {"description": "Stored", **_OFFSET_HEADERS}},
)
async def append_to_upload(
    id: Id,
    request: Request,
    owned: OwnedDep,
    tus_resumable: _Version = None,
    upload_offset: Annotated[str | None, Header(description="Number of bytes already received")] = None,
    content_type: Annotated[str | None, Header()] = None,
) -> Response:
    """Append to an upload. Bytes received before a connection breaks are stored."""
    _require_version(tus_resumable)
    if content_type is None or content_type.partition(";")[0].strip() != CONTENT_TYPE:
        raise ProblemError("unsupported-format", f"Content-Type is {content_type!r}; send {CONTENT_TYPE}")
    offset = _bytes_of("Upload-Offset", upload_offset, "the number of bytes that are there")
    record = await run_in_threadpool(upload, owned.store, id)
    if record.state != "receiving":
        if offset != record.received:
            raise wrong_offset(offset, record.received)
        return Response(status_code=204, headers=_offset_headers(record))
    await run_in_threadpool(require_room, owned)
    record = await _append(owned, record, request.stream(), offset)
    return Response(status_code=204, headers=_offset_headers(record))


@router.get("/{id}", responses=refusals("not-found", "expired"))
async def get_upload(id: Id, owned: OwnedDep, wait_s: WaitS) -> UploadPayload:
    """Return an upload: state, size, asset. Prefer: wait=N waits until the asset exists or the upload has failed."""
    deadline = time.monotonic() + wait_s
    while True:
        record = await run_in_threadpool(upload, owned.store, id)
        settled = record.state in {"ready", "failed"} or (record.state == "received" and not record.make_asset)
        if settled or time.monotonic() >= deadline:
            break
        await asyncio.sleep(_POLL_S)
    return upload_payload(await run_in_threadpool(_with_size, owned, record))


@router.post("/{id}/parts", responses=refusals("not-found", "expired", "conflict"))
def create_upload_parts(id: Id, owned: OwnedDep) -> UploadPartsPayload:
    """Return URLs in object storage to PUT the missing bytes to; then PATCH at the full length without a body.

    Status 409 if uploads are stored in a folder, or the setting `presigned_links` is off.
    """
    record = upload(owned.store, id)
    parts, begin = owned.services.upload_parts, owned.services.upload_parts.size(id)
    if record.state != "receiving" or record.length is None:
        raise ConflictError(f"upload {id} is {record.state}; nothing is missing")
    missing = []
    for offset in range(begin, record.length, PART_BYTES):
        url = parts.link(id, offset) if owned.services.settings.presigned_links else None
        if url is None:
            raise ConflictError("this service gives no addresses of its storage; send the bytes with PATCH")
        missing.append(UploadPartPayload(offset=offset, bytes=min(PART_BYTES, record.length - offset), url=url))
    until = owned.store.clock() + LINK_S
    change_upload(owned.store, id, expires_at=max(record.expires_at, until))
    return UploadPartsPayload.of(None, parts=missing, expires_at=until)


@router.delete(
    "/{id}", status_code=204, response_class=Response, responses=refusals("not-found", "expired", "precondition-failed")
)
def delete_upload_(id: Id, owned: OwnedDep, tus_resumable: _Version = None) -> Response:
    """Delete an upload. An asset that was made from it remains."""
    _require_version(tus_resumable)
    upload(owned.store, id)
    owned.services.upload_parts.delete(id)
    delete_upload(owned.store, id)
    return Response(status_code=204)


def _with_size(owned: Owned, record: UploadRecord) -> UploadRecord:
    """Return the record with the number of bytes received so far."""
    if record.state != "receiving":
        return record
    return replace(record, received=owned.services.upload_parts.size(record.id))


async def _append(owned: Owned, record: UploadRecord, body: AsyncIterator[bytes], offset: int) -> UploadRecord:
    """Append a body; close a complete upload and check its sha256."""
    size = await append(owned, record, body, offset)
    changes: dict[str, Any] = {"received": size}
    if size:
        changes["expires_at"] = owned.store.clock() + owned.services.settings.upload_retention_s
    if size == record.length:
        changes["state"] = "received"
        if record.sha256 is not None:
            await run_in_threadpool(_require_checksum, owned, record)
    record = await run_in_threadpool(change_upload, owned.store, record.id, was=("receiving",), **changes)
    if record.state == "received" and record.make_asset:
        owned.services.ingest_wakeup.set()
    return record


def _require_checksum(owned: Owned, record: UploadRecord) -> None:
    with TemporaryDirectory(prefix="check-", dir=owned.services.settings.scratch_dir) as folder:
        owned.services.upload_parts.fetch(record.id, path := Path(folder) / "whole")
        digest, _ = hash_file(path)
    if digest != record.sha256:
        owned.services.upload_parts.delete(record.id)
        raise ProblemError("checksum-mismatch", f"the sha256 is {digest}, {record.sha256} was promised; send it anew")


def _require_version(given: str | None) -> None:
    if given != TUS_VERSION:
        detail = f"Tus-Resumable {_quoted(given)}; {TUS_VERSION} is spoken here"
        raise ProblemError("precondition-failed", detail, headers={"Tus-Version": TUS_VERSION})


def _bytes_of(name: str, header: str | None, what: str) -> int:
    if header is None or not (header.isascii() and header.isdecimal()) or len(header) > 18:
        raise ProblemError("bad-request", f"{name} {_quoted(header)}; send {what}")
    return int(header)


def _quoted(header: str | None) -> str:
    return "is not sent" if header is None else f"is {header!r}"


def _length(header: str | None, owned: Owned) -> int:
    length = _bytes_of("Upload-Length", header, "the size of the file in bytes")
    allowed = owned.services.settings.max_upload_bytes
    if length > allowed:
        raise ProblemError("payload-too-large", f"Upload-Length is {length:,}; at most {allowed:,} are allowed")
    if length == 0:
        raise ProblemError("invalid-input", "Upload-Length is 0; an empty file is no tree")
    return length


def _metadata(header: str | None) -> UploadMetadata:
    """Parse the pairs of Upload-Metadata that the service uses."""
    if header is not None and len(header) > MAX_METADATA_CHARS:
        raise ProblemError("bad-request", f"Upload-Metadata has more than {MAX_METADATA_CHARS} characters")
    pairs: dict[str, str] = {}
    for pair in (header or "").split(","):
        name, _, encoded = pair.strip().partition(" ")
        try:
            pairs[name] = base64.b64decode(encoded.strip(), validate=True).decode()
        except ValueError as error:
            detail = f"the value of {name!r} is no base64 of UTF-8"
            raise wrong_field(f"metadata:{name}", "not-base64", detail) from error
    own = {name: pairs[name] for name in UploadMetadata.model_fields if name in pairs}
    return UploadMetadata.read(own, where="metadata")


def _offset_headers(record: UploadRecord) -> dict[str, str]:
    return {"Upload-Offset": str(record.received), "Upload-Expires": formatdate(record.expires_at, usegmt=True)}
