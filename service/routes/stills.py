"""/v1/jobs/{id}/still: a small picture of the tree, for lists and for who waits."""

import io

from fastapi import APIRouter
from fastapi.responses import Response
from PIL import Image

from jobs.errors import GoneError
from service.http.problems import ProblemError
from service.http.routing import CACHED, Id, file_of, refusals
from service.services import OwnedDep

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

PREVIEW = "preview.png"
SIZE_PX = (160, 232)
"""Of the frames side by side at the preview's foot."""

WEBP = "image/webp"
QUALITY = 80


@router.get(
    "/{id}/still",
    operation_id="getStill",
    response_class=Response,
    responses=refusals("not-found", "expired") | file_of(WEBP, "160 × 232 pixels, some 10 kB"),
)
def get_still(id: Id, owned: OwnedDep) -> Response:
    """The first frame of a job's preview, once it is written."""
    written = {artifact.name: artifact for artifact in owned.store.artifacts_of(owned.store.job(id).id)}
    preview = written.get(PREVIEW)
    if preview is None:
        raise ProblemError("not-found", f"the job {id} has no {PREVIEW}; it writes one where formats has png")
    if not owned.services.artifacts.exists(preview.sha256):
        raise GoneError(f"the bytes of {PREVIEW} were removed; run the job again")
    width, height = SIZE_PX
    still = io.BytesIO()
    with Image.open(io.BytesIO(b"".join(owned.services.artifacts.read(preview.sha256)))) as sheet:
        sheet.crop((0, sheet.height - height, width, sheet.height)).save(still, "WEBP", quality=QUALITY)
    return Response(still.getvalue(), 200, CACHED, WEBP)
