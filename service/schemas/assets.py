"""Bodies of assets and uploads."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator
from pydantic_core import from_json

from dynamictree.requests import Reading
from jobs.records import UploadRecord, UploadState
from jobs.states import AssetKind
from service.http.multipart import MAX_FILES, MAX_NAME_CHARS
from service.http.problems import wrong_field
from service.http.validation_errors import invalid_fields
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


class AssetOptions(Reading):
    """How to read the files of an asset, and what comes back with it."""

    kind: AssetKind | None = Field(default=None, description="by name if unset")
    metadata: Metadata | None = Field(default=None, description="texts of yours, returned as they are")

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


_NAME = r"^[^\x00-\x1f\x7f]*$"


class UploadMetadata(AssetOptions):
    """What `Upload-Metadata` may hold."""

    filename: str | None = Field(default=None, max_length=MAX_NAME_CHARS, pattern=_NAME)
    name: str | None = Field(default=None, max_length=MAX_NAME_CHARS, pattern=_NAME)
    sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$")
    asset: Literal["auto"] | None = None


class AssetRequest(AssetOptions):
    """What to make an asset of: uploads that are whole, or an address."""

    upload_ids: list[Annotated[str, Field(pattern=ULID_PATTERN)]] | None = Field(
        default=None, min_length=1, max_length=MAX_FILES, description="a mesh and what it names, photos, or one zip"
    )
    url: str | None = Field(default=None, max_length=2048, description="https; fetched once, redirects are checked too")
    sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$", description="of the file at the address")
    filename: str | None = Field(default=None, min_length=1, max_length=255, description="the address' own if unset")

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


def upload_payload(upload: UploadRecord) -> UploadPayload:
    """Return an upload as a response body."""
    error = problem_of(upload.error_code, upload.error_message)
    return UploadPayload.of(upload, bytes_received=upload.received, error=error)
