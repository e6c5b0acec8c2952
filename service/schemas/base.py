"""Base classes and types of request and response bodies. Unknown fields are refused."""

from datetime import datetime
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field

from dynamictree.request_model import Bounded, Pattern
from dynamictree.request_model import Finite as Finite
from service.http.problems import KINDS, problem_body

ULID_PATTERN = "^[0-9A-HJKMNP-TV-Z]{26}$"

Ulid = Annotated[str, Pattern(ULID_PATTERN, "an id that the service returned: 26 letters and digits")]
Sha256 = Annotated[str, Pattern("^[0-9a-f]{64}$", "a hash in 64 hexadecimal digits, lower case")]
Metadata = Annotated[
    dict[Annotated[str, Field(max_length=64)], Annotated[str, Field(max_length=512)]], Field(max_length=16)
]

Time = Annotated[datetime, Field(description="Time (RFC 3339, UTC)")]


class Payload(Bounded):
    """Base class of all bodies."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def of(cls, record: object, **others: object) -> Self:
        """Build a body from a record's fields of the same names; times in seconds since 1970 become RFC 3339."""
        own = {name: getattr(record, name) for name in cls.model_fields if name not in others and hasattr(record, name)}
        return cls.model_validate(own | others, from_attributes=True)


class FieldErrorPayload(Payload):
    """One invalid field."""

    pointer: str = Field(description="JSON pointer into the body, or location:name")
    code: str
    detail: str


class Problem(BaseModel):
    """Problem object (RFC 9457). Some problems have additional members."""

    model_config = ConfigDict(extra="allow", frozen=True)

    type: str = Field(description="urn:dynamictree:problem:CODE")
    title: str
    status: int
    detail: str
    code: str
    request_id: str | None
    retryable: bool
    suggestion: str
    errors: list[FieldErrorPayload]


def problem_of(code: str | None, message: str | None) -> Problem | None:
    """Return the problem of a failed job or upload; None if it did not fail."""
    if code is None:
        return None
    valid_code = code if code in KINDS else "internal-error"
    return Problem.model_validate(problem_body(valid_code, message or "", request_id=None))
