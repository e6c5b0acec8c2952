"""/v1/assets: what jobs work on."""

import shutil
from pathlib import Path

from fastapi import APIRouter, Request, Response, status
from starlette.concurrency import run_in_threadpool

from jobs.store import new_id
from service.context import Context, Ctx
from service.intake import MESH_SUFFIXES, PHOTO_SUFFIXES, UP_AXES, admit, sort_out
from service.multipart import receive_form
from service.payloads import AssetPayload, asset_payload
from service.problems import ProblemError
from service.routing import Id, headers, refusals

router = APIRouter(prefix="/v1/assets", tags=["assets"])

_FORM = {
    "requestBody": {
        "required": True,
        "description": f"One mesh ({', '.join(MESH_SUFFIXES)}) and what it names (MTL, textures), or 8 to 300 "
        f"photos ({', '.join(PHOTO_SUFFIXES)}), as parts with filenames; or one zip of either.",
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "additionalProperties": False,
                    "properties": {
                        "file": {
                            "type": "array",
                            "minItems": 1,
                            "items": {"type": "string", "contentMediaType": "application/octet-stream"},
                        },
                        "kind": {
                            "type": "string",
                            "enum": ["mesh", "photos"],
                            "description": "by name if unset",
                        },
                        "up_axis": {
                            "type": "string",
                            "enum": list(UP_AXES),
                            "description": "the format's own if unset",
                        },
                        "unit_m": {"type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "metres a unit"},
                    },
                }
            }
        },
    }
}


@router.post(
    "",
    operation_id="createAsset",
    status_code=status.HTTP_201_CREATED,
    openapi_extra=_FORM,
    responses=refusals(
        "invalid-geometry",
        "archive-rejected",
        "input-too-costly",
        "unsupported-format",
        "request-timeout",
        "disk-full",
    )
    | {
        200: {"description": "The same files were sent before; the same asset", "model": AssetPayload},
        201: {"description": "A new asset", **headers(Location="the asset")},
    },
)
async def create_asset(request: Request, response: Response, context: Ctx) -> AssetPayload:
    """Upload a mesh or a batch of photos."""
    require_room(context)
    folder = context.settings.scratch_dir / f"upload-{new_id()}"
    await run_in_threadpool(folder.mkdir, parents=True)
    try:
        form = await receive_form(request.headers.get("content-type", ""), request.stream(), folder)
        upload = await run_in_threadpool(sort_out, form, folder)
        asset, new = await admit(context, upload, folder)
    finally:
        await run_in_threadpool(shutil.rmtree, folder)
    response.headers["Location"] = f"/v1/assets/{asset.id}"
    response.status_code = status.HTTP_201_CREATED if new else status.HTTP_200_OK
    return asset_payload(asset)


@router.get("/{id}", operation_id="getAsset", responses=refusals("not-found", "expired"))
def get_asset(id: Id, context: Ctx) -> AssetPayload:
    """What was uploaded, and what was found in it."""
    return asset_payload(context.store.asset(id))


@router.delete(
    "/{id}",
    operation_id="deleteAsset",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=refusals("not-found", "conflict", "expired"),
)
def delete_asset(id: Id, context: Ctx) -> None:
    """Forget an upload. What was made of it stays until it expires."""
    context.store.delete_asset(id)


def require_room(context: Context) -> None:
    """Refuse what would fill the disk.

    Raises:
        ProblemError: less than `min_free_bytes` are left.
    """
    scratch: Path = context.settings.scratch_dir
    scratch.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(scratch).free
    if free < context.settings.min_free_bytes:
        found = f"{free:,} bytes are free; {context.settings.min_free_bytes:,} are kept free"
        raise ProblemError("disk-full", found)
