"""Bodies of assets and uploads."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from dynamictree.requests import Reading
from jobs.records import UploadRecord, UploadState
from jobs.states import AssetKind
from service.http.multipart import MAX_FILES
from service.schemas.base import ULID_PATTERN, Metadata, Payload, Problem, Time, problem_of


class PartPayload(Payload):
    """One file of an asset."""

    name: str
    sha256: str
    bytes: int


AssetSummary = dict[str, str | int | float | list[float | dict[str, str | int | float]] | None]


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
    """What to make an asset of: uploads that are whole, or an address."""

    upload_ids: list[Annotated[str, Field(pattern=ULID_PATTERN)]] | None = Field(
        default=None, min_length=1, max_length=MAX_FILES, description="a mesh and what it names, photos, or one zip"
    )
    url: str | None = Field(default=None, max_length=2048, description="https; fetched once, redirects are checked too")
    sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$", description="of the file at the address")
    filename: str | None = Field(default=None, min_length=1, max_length=255, description="the address' own if unset")
    kind: AssetKind | None = Field(default=None, description="by name if unset")
    metadata: Metadata | None = Field(default=None, description="texts of yours, returned as they are")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.upload_ids is None) == (self.url is None):
            raise ValueError("give either upload_ids or url")
        if self.url is None and (self.sha256 or self.filename):
            raise ValueError("sha256 and filename go with url; those of uploads are in Upload-Metadata")
        if self.filename is not None and "\0" in self.filename:
            raise ValueError("filename holds a NUL; leave it out")
        return self


class UploadPayload(Payload):
    """A file that comes in pieces, or from an address."""

    id: str
    state: UploadState = Field(description="receiving or fetching; received; ready with an asset; failed")
    filename: str
    bytes_received: int
    length: int | None = Field(description="null while an address does not tell")
    sha256: str | None = Field(description="as promised")
    asset_id: str | None
    error: Problem | None
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
    return UploadPayload.of(upload, bytes_received=size, error=problem_of(upload.error_code, upload.error_message))
