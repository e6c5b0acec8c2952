"""/v1/artifacts: download files, whole or in part. An id's content never changes; its hash is its ETag."""

from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Header, Query, Response
from fastapi.responses import RedirectResponse, StreamingResponse

from jobs.errors import GoneError
from jobs.records import ArtifactRecord
from service.http.request_headers import matches, parse_range
from service.http.routing import Id, headers, refusals
from service.services import OwnedDep

router = APIRouter(prefix="/v1/artifacts", tags=["artifacts"])

_BYTES = {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}
_RESPONSES = refusals("not-found", "expired", "range-not-satisfiable") | {
    200: {"description": "The whole file", **_BYTES, **headers(ETag="SHA-256 of the file", Accept_Ranges="bytes")},
    206: {"description": "The requested range", **_BYTES, **headers(Content_Range="bytes FIRST-LAST/SIZE")},
    307: {"description": "Redirect, with the setting `presigned_links`", **headers(Location="URL of the bytes")},
    304: {"description": "Unchanged: the file has the ETag that was sent"},
}


@router.get("/{id}", response_class=Response, responses=_RESPONSES)
def get_artifact(
    id: Id,
    owned: OwnedDep,
    range: Annotated[str | None, Header(description="One range of bytes; several return the whole file")] = None,
    if_range: Annotated[str | None, Header(description="ETag; range applies only if it is the file's")] = None,
    if_none_match: Annotated[str | None, Header()] = None,
    filename: Annotated[str | None, Query(max_length=255, description="Name for saving; by default the file's")] = None,
) -> Response:
    """Download a file, or resume a download."""
    artifact = owned.store.artifact(id)
    if matches(if_none_match, _etag(artifact)):
        return Response(status_code=304, headers=_headers(artifact, filename))
    part = parse_range(range, artifact.bytes) if if_range is None or if_range.strip() == _etag(artifact) else None
    if not owned.services.artifacts.exists(artifact.sha256):
        raise GoneError(f"the bytes of artefact {id} were removed; run the job again")
    if owned.services.settings.presigned_links and (link := owned.services.artifacts.link(artifact.sha256)):
        return RedirectResponse(link, headers={"Cache-Control": "no-store"})
    start, stop = (0, artifact.bytes) if part is None else (part.start, part.stop)
    sent = _headers(artifact, filename) | {"Content-Length": str(stop - start)}
    if part is not None:
        sent["Content-Range"] = f"bytes {start}-{stop - 1}/{artifact.bytes}"
    return StreamingResponse(
        owned.services.artifacts.read(artifact.sha256, start=start, stop=stop),
        status_code=200 if part is None else 206,
        headers=sent,
        media_type=artifact.media_type,
    )


@router.head("/{id}", response_class=Response, responses=_RESPONSES)
def head_artifact(id: Id, owned: OwnedDep, if_none_match: Annotated[str | None, Header()] = None) -> Response:
    """Return the size, hash and type of a file in headers."""
    artifact = owned.store.artifact(id)
    if matches(if_none_match, _etag(artifact)):
        return Response(status_code=304, headers=_headers(artifact))
    sent = _headers(artifact) | {"Content-Length": str(artifact.bytes)}
    return Response(headers=sent, media_type=artifact.media_type)


def _etag(artifact: ArtifactRecord) -> str:
    return f'"{artifact.sha256}"'


def _headers(artifact: ArtifactRecord, filename: str | None = None) -> dict[str, str]:
    return {
        "ETag": _etag(artifact),
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, max-age=86400, immutable",
        "Content-Disposition": f"attachment; filename*=UTF-8''{quote(filename or artifact.name, safe='')}",
    }
