"""Bodies of assets and uploads."""

from typing import Annotated

from pydantic import Field

from dynamictree.requests import Reading
from jobs.states import AssetKind
from jobs.storage.uploads import UploadRecord, UploadState
from service.http.multipart import MAX_FILES
from service.schemas.base import ULID_PATTERN, Metadata, Payload, Time


class PartPayload(Payload):
    """One file of an asset."""

    name: str
    sha256: str
    bytes: int


AssetSummary = dict[
    str, str | int | float | list[float] | list[dict[str, str | int]] | list[dict[str, int | float]] | None
]


class AssetPayload(Payload):
    """An upload that was read and can be used."""

    id: str
    kind: AssetKind
    parts: list[PartPayload]
    summary: AssetSummary = Field(
        description="what was found in it, lengths in metres; `warnings` are objects with `code` and `message`, "
        "`still_parts` what is not the plant and does not move: `name` and `why`, "
        "`trees` where each stands and how tall it is: `tree` (its number), `x_m`, `y_m`, `z_m` and `height_m`"
    )
    metadata: dict[str, str]
    created_at: Time
    expires_at: Time


class AssetRequest(Reading):
    """Uploads to make an asset of, once they are whole."""

    upload_ids: list[Annotated[str, Field(pattern=ULID_PATTERN)]] = Field(
        min_length=1, max_length=MAX_FILES, description="a mesh and what it names, photos, or one zip"
    )
    kind: AssetKind | None = Field(default=None, description="by name if unset")
    metadata: Metadata | None = Field(default=None, description="texts of yours, returned as they are")


class UploadPayload(Payload):
    """A file that comes in pieces."""

    id: str
    state: UploadState = Field(description="receiving; received; ready with an asset")
    filename: str
    bytes_received: int
    length: int
    sha256: str | None = Field(description="as promised")
    asset_id: str | None
    created_at: Time
    expires_at: Time


class UploadPartPayload(Payload):
    """One piece of an upload, to PUT to object storage."""

    offset: int
    bytes: int
    url: str


class UploadPartsPayload(Payload):
    """The pieces that an upload lacks."""

    parts: list[UploadPartPayload]
    expires_at: Time


def upload_payload(upload: UploadRecord, size: int) -> UploadPayload:
    """An upload as a response body, with the number of bytes received."""
    return UploadPayload.of(upload, bytes_received=size)
