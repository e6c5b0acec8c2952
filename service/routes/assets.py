"""/v1/assets: upload, read and delete the inputs of jobs."""

from contextlib import AsyncExitStack
from pathlib import PurePosixPath
from urllib.parse import unquote, urlsplit

from fastapi import APIRouter, Request, Response
from fastapi.concurrency import contextmanager_in_threadpool
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from dynamictree.formats.suffixes import CLOUD_SUFFIXES, FILM_SUFFIXES, MASK_NAME, MESH_SUFFIXES, PHOTO_SUFFIXES
from dynamictree.requests import Reading
from jobs.records import AssetRecord
from jobs.states import ASSET_KINDS
from jobs.storage import assets as asset_rows
from jobs.storage.uploads import upload
from service.http.multipart import MAX_FILES, receive_form
from service.http.request_headers import JSON
from service.http.routing import Id, headers, refusals
from service.http.validation_errors import invalid_fields
from service.schemas.assets import AssetOptions, AssetPayload, AssetRequest, UploadPayload, upload_payload
from service.services import Owned, OwnedDep
from service.uploads.ingest import BYTES_ALLOWED, make_asset
from service.uploads.intake import parse_and_store, scratch_folder
from service.uploads.quota import announce_upload, reserve_space

router = APIRouter(prefix="/v1/assets", tags=["assets"])

_FORM = {
    "requestBody": {
        "required": True,
        "description": f"One mesh ({', '.join(MESH_SUFFIXES)}) and what it names (MTL, textures); or one splat or scan "
        f"({', '.join(CLOUD_SUFFIXES)}), with a mesh that lies where it lies and a {MASK_NAME} if you have them (one "
        "bool a Gaussian: where it may move); or 8 to 300 "
        f"photos ({', '.join(PHOTO_SUFFIXES)}), as parts with filenames; or a film of a walk around one tree "
        f"({', '.join(FILM_SUFFIXES)}); or one zip of any of these.",
        "content": {
            "application/json": {"schema": AssetRequest.model_json_schema()},
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "additionalProperties": False,
                    "properties": {
                        "file": {
                            "type": "array",
                            "minItems": 1,
                            "maxItems": MAX_FILES,
                            "items": {"type": "string", "contentMediaType": "application/octet-stream"},
                        },
                        "kind": {"type": "string", "enum": list(ASSET_KINDS), "description": "By file name if unset"},
                        "metadata": {"type": "string", "description": "JSON object of your texts, returned unchanged"},
                        **{
                            name: field["anyOf"][0] | {"description": field["description"]}  # forms have no null
                            for name, field in Reading.model_json_schema()["properties"].items()
                        },
                    },
                }
            },
        },
    }
}


@router.post(
    "",
    status_code=201,
    response_model=AssetPayload,
    openapi_extra=_FORM,
    responses=refusals(
        *("invalid-geometry", "archive-rejected", "input-too-costly", "unsupported-format", "request-timeout"),
        *("disk-full", "not-found", "expired", "conflict", "checksum-mismatch", "fetch-failed", "quota-exceeded"),
    )
    | {
        200: {"description": "The existing asset with the same files", "model": AssetPayload},
        201: {"description": "A new asset", **headers(Location="URL of the asset")},
        202: {
            "description": "The URL is being fetched; poll the upload for the asset",
            "model": UploadPayload,
            **headers(Location="URL of the upload", Retry_After="seconds until the next poll"),
        },
    },
)
async def create_asset(request: Request, response: Response, owned: OwnedDep) -> AssetPayload | Response:
    """Create an asset from sent files (a mesh, splat, scan, photos or a film), from uploads, or from a URL."""
    length = int(request.headers.get("content-length", "0"))
    content_type = request.headers.get("content-type", "")
    if content_type.partition(";")[0].strip() == JSON:
        return await _of_uploads_or_address(request, response, owned)
    async with AsyncExitStack() as room:
        await room.enter_async_context(contextmanager_in_threadpool(reserve_space(owned, length)))
        folder = await room.enter_async_context(scratch_folder(owned))
        form = await receive_form(content_type, request.stream(), folder)
        if not length:  # no Content-Length: the size counts once the body is received
            sent = sum(file.bytes for file in form.files)
            await room.enter_async_context(contextmanager_in_threadpool(reserve_space(owned, sent)))
        asset, new = await parse_and_store(owned, AssetOptions.read(form.fields, where="form"), form.files, folder)
    return _asset_response(asset, new, response)


async def _of_uploads_or_address(request: Request, response: Response, owned: Owned) -> AssetPayload | Response:
    try:
        wanted = AssetRequest.model_validate_json(await request.body())
    except ValidationError as error:
        raise invalid_fields(error.errors(include_url=False), "body") from None
    if wanted.upload_ids is not None:
        uploads = [await run_in_threadpool(upload, owned.store, id) for id in wanted.upload_ids]
        asset, new = await make_asset(owned, uploads, wanted)
        return _asset_response(asset, new, response)
    assert wanted.url is not None
    # refuses a wrong address at once; it is checked again at the connection
    await owned.services.outbound.check(wanted.url)
    allowed, name = owned.caller.limits.get("bytes"), PurePosixPath(unquote(urlsplit(wanted.url).path)).name
    record = await run_in_threadpool(
        announce_upload,
        owned,
        owned.services.settings.upload_retention_s,
        state="fetching",
        filename=wanted.filename or name[:255].replace("\0", "") or "file",
        options=wanted.stored() | ({} if allowed is None else {BYTES_ALLOWED: allowed}),
        length=None,
        sha256=wanted.sha256,
        source_url=wanted.url,
        make_asset=True,
    )
    owned.services.ingest_wakeup.set()
    sent = {"Location": f"/v1/uploads/{record.id}", "Retry-After": "1"}
    return Response(upload_payload(record).model_dump_json(), 202, sent, "application/json")


def _asset_response(asset: AssetRecord, new: bool, response: Response) -> AssetPayload:
    response.headers["Location"] = f"/v1/assets/{asset.id}"
    response.status_code = 201 if new else 200
    return AssetPayload.of(asset)


@router.get("/{id}", responses=refusals("not-found", "expired"))
def get_asset(id: Id, owned: OwnedDep) -> AssetPayload:
    """Return an asset: its files and a summary of their content."""
    return AssetPayload.of(asset_rows.read_asset(owned.store, id))


@router.delete("/{id}", status_code=204, responses=refusals("not-found", "conflict", "expired"))
def delete_asset(id: Id, owned: OwnedDep) -> None:
    """Delete an asset. Products that were made from it remain until they expire."""
    asset_rows.delete_asset(owned.store, id)
