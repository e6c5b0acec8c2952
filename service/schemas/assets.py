"""Bodies of assets and uploads."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator
from pydantic_core import from_json

from dynamictree.request_model import Pattern
from dynamictree.requests import Reading
from jobs.records import UploadRecord, UploadState
from jobs.states import AssetKind
from service.http.multipart import MAX_FILES, MAX_NAME_CHARS
from service.http.problems import wrong_field
from service.http.validation_errors import invalid_fields
from service.schemas.base import Metadata, Payload, Problem, Sha256, Time, Ulid, problem_of


class PartPayload(Payload):
    """One file of an asset."""

    name: str
    sha256: str
    bytes: int


AssetSummary = dict[str, str | int | float | list[float | dict[str, str | int | float]] | None]


class AssetPayload(Payload):
    """An asset: files that were read and that jobs can use."""

    id: str
    kind: AssetKind
    parts: list[PartPayload]
    summary: AssetSummary = Field(
        description="Content of the files, lengths in metres; `warnings` are objects with `code` and `message`, "
        "`still_parts` (parts that are no plant and do not move) with `name` and `why`, "
        "`trees` with `tree` (number), foot `x_m`, `y_m`, `z_m` and `height_m`"
    )
    metadata: dict[str, str]
    created_at: Time
    expires_at: Time


class AssetOptions(Reading):
    """How to read the files of an asset, and texts that are returned with it."""

    kind: AssetKind | None = Field(default=None, description="By file name if unset")
    metadata: Metadata | None = Field(default=None, description="Your texts, returned unchanged")

    @classmethod
    def read(cls, values: Mapping[str, object], *, where: str) -> Self:
        """Validate the text fields of a form or of `Upload-Metadata`; `where` is their location in errors.

        Raises:
            ProblemError: a field is unknown or not allowed.
        """
        values = dict(values)
        try:
            if isinstance(texts := values.get("metadata"), str):
                values["metadata"] = from_json(texts)
            return cls.model_validate(values, strict=False)
        except ValidationError as error:
            # an error about too many items has no location; only `metadata` has items
            located = [{**one, "loc": one["loc"][:1] or ("metadata",)} for one in error.errors()]
            raise invalid_fields(located, where) from None
        except ValueError as error:
            raise wrong_field(f"{where}:metadata", "json-invalid", f"metadata is no JSON object: {error}") from None

    def stored(self) -> dict[str, Any]:
        """Return the options that were given, as they are stored with an upload."""
        return self.model_dump(mode="json", include=set(AssetOptions.model_fields), exclude_none=True)


_Name = Annotated[
    str, Field(max_length=MAX_NAME_CHARS), Pattern(r"^[^\x00-\x1f\x7f]*$", "a name without control characters")
]


class UploadMetadata(AssetOptions):
    """Fields of `Upload-Metadata`."""

    filename: _Name | None = None
    name: _Name | None = None
    sha256: Sha256 | None = None
    asset: Literal["auto"] | None = None


class AssetRequest(AssetOptions):
    """Source of an asset: complete uploads, or a URL."""

    upload_ids: list[Ulid] | None = Field(
        default=None, min_length=1, max_length=MAX_FILES, description="A mesh with companion files, photos, or one zip"
    )
    url: str | None = Field(default=None, max_length=2048, description="HTTPS address, which is fetched once")
    sha256: Sha256 | None = Field(default=None, description="Hash of the fetched file")
    filename: str | None = Field(default=None, min_length=1, max_length=255, description="By default that of the URL")

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
    """A file that is received in parts, or fetched from a URL."""

    id: str
    state: UploadState = Field(description="receiving or fetching, received, ready (has an asset), failed")
    filename: str
    bytes_received: int
    length: int | None = Field(description="Size of the file [bytes]; null while unknown")
    sha256: str | None = Field(description="Announced hash of the file")
    asset_id: str | None
    error: Problem | None
    created_at: Time
    expires_at: Time


class UploadPartPayload(Payload):
    """One part of an upload, to PUT to object storage."""

    offset: int
    bytes: int
    url: str


class UploadPartsPayload(Payload):
    """The missing parts of an upload."""

    parts: list[UploadPartPayload]
    expires_at: Time


def upload_payload(upload: UploadRecord) -> UploadPayload:
    """Return an upload as a response body."""
    error = problem_of(upload.error_code, upload.error_message)
    return UploadPayload.of(upload, bytes_received=upload.received, error=error)
