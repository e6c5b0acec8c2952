"""Errors as RFC 9457 problem objects: one shape, one table from code to status."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict, get_args

import orjson
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import Scope

from dynamictree.errors import DynamicTreeError
from jobs.errors import JobsError

logger = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:dynamictree:problem:"
REQUEST_ID = "dynamictree.request_id"
"""Where the outermost middleware leaves the request's id in its scope."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What is the same for every problem of one code."""

    status: int
    title: str
    suggestion: str
    retryable: bool = False


KINDS: dict[str, Kind] = {
    "validation-failed": Kind(
        status=422, title="The request is not valid", suggestion="Mend the fields named in errors."
    ),
    "invalid-input": Kind(status=422, title="The input cannot be used", suggestion="Change what detail names."),
    "invalid-geometry": Kind(
        status=422,
        title="The geometry cannot be used",
        suggestion="Repair the mesh as detail says, and upload it again.",
    ),
    "archive-rejected": Kind(
        status=422,
        title="The archive is refused",
        suggestion="Send a flat zip of the mesh and the files that it names.",
    ),
    "input-too-costly": Kind(
        status=422, title="The input takes too much to read", suggestion="Simplify or decimate it, and upload it again."
    ),
    "numerics-error": Kind(
        status=422, title="The result is not finite", suggestion="Use smaller forces or time steps."
    ),
    "unstable-timestep": Kind(status=422, title="The time step is not stable", suggestion="Use at most max_dt_s."),
    "bad-request": Kind(status=400, title="The request cannot be read", suggestion="Send well-formed HTTP and JSON."),
    "unauthorized": Kind(status=401, title="A key is needed", suggestion="Ask the operator for a key."),
    "forbidden": Kind(status=403, title="That is not allowed", suggestion="Ask the operator, or see docs/keys.md."),
    "not-found": Kind(status=404, title="There is no such thing", suggestion="Check the id and the path."),
    "method-not-allowed": Kind(status=405, title="The method is not allowed here", suggestion="See the Allow header."),
    "not-acceptable": Kind(
        status=406, title="No such representation", suggestion="Accept a media type that detail names."
    ),
    "request-timeout": Kind(
        status=408, title="The upload stood still", suggestion="Send it again on a steady line.", retryable=True
    ),
    "conflict": Kind(status=409, title="The state forbids it", suggestion="Look at the state, then decide again."),
    "upload-offset-conflict": Kind(
        status=409, title="The upload stands elsewhere", suggestion="Ask where with HEAD, and go on from there."
    ),
    "precondition-failed": Kind(status=412, title="The protocol is another one", suggestion="Speak tus 1.0.0."),
    "checksum-mismatch": Kind(
        status=460, title="The bytes are not those of the checksum", suggestion="Send them again.", retryable=True
    ),
    "fetch-failed": Kind(
        status=422, title="The address could not be fetched", suggestion="Check it, or upload the file itself."
    ),
    "quota-exceeded": Kind(
        status=429, title="Too much is stored", suggestion="Delete uploads, or wait until products expire."
    ),
    "too-many-active-jobs": Kind(
        status=429, title="Too many of your jobs run", suggestion="Wait for one to end.", retryable=True
    ),
    "rate-limited": Kind(status=429, title="Too many requests", suggestion="Wait as Retry-After says.", retryable=True),
    "idempotency-key-reused": Kind(
        status=422, title="The key means another request", suggestion="Use a new Idempotency-Key."
    ),
    "expired": Kind(status=410, title="It is gone", suggestion="Make it again."),
    "payload-too-large": Kind(status=413, title="The body is too large", suggestion="See GET /v1/limits."),
    "unsupported-format": Kind(
        status=415, title="The format is not supported", suggestion="See GET /v1/limits for formats."
    ),
    "range-not-satisfiable": Kind(status=416, title="The range is outside", suggestion="Ask for bytes below the size."),
    "internal-error": Kind(
        status=500,
        title="The service failed",
        suggestion="Try again; report the request_id if it stays.",
        retryable=True,
    ),
    "model-error": Kind(status=500, title="The model cannot be used", suggestion="Tell the operator."),
    "overloaded": Kind(status=503, title="Too much is asked at once", suggestion="Try again later.", retryable=True),
    "queue-full": Kind(status=503, title="Too many jobs wait", suggestion="Try again later.", retryable=True),
    "disk-full": Kind(status=503, title="The storage is full", suggestion="Try again later.", retryable=True),
    "storage-unavailable": Kind(status=503, title="A storage is away", suggestion="Try again later.", retryable=True),
    # failures of jobs; their status is that of a GET which shows them nowhere but in the job's `error`
    "canceled": Kind(status=409, title="The job was canceled", suggestion="Create it again."),
    "out-of-memory": Kind(status=500, title="Out of memory", suggestion="Simplify the input, or ask for less."),
    "time-limit": Kind(status=500, title="The job took too long", suggestion="Simplify the input, or ask for less."),
    "worker-lost": Kind(status=500, title="The worker was lost", suggestion="Create the job again.", retryable=True),
    "poison-input": Kind(status=500, title="The input takes every worker down", suggestion="Simplify the input."),
    "reconstruction-failed": Kind(
        status=422, title="The photos do not fit together", suggestion="Take more photos, with more overlap."
    ),
    "camera-search-failed": Kind(
        status=500,
        title="The search for cameras failed",
        suggestion="Try again; report the job's id if it stays.",
        retryable=True,
    ),
    "start-deadline": Kind(
        status=503, title="Not started in time", suggestion="Ask later, or with a later deadline.", retryable=True
    ),
}


class FieldError(TypedDict):
    """One field that is wrong."""

    pointer: str
    code: str
    detail: str


class ProblemError(HTTPException):
    """A request that is refused. An HTTPException, so that FastAPI's body parser lets it pass."""

    def __init__(
        self,
        code: str,
        detail: str,
        *,
        errors: Sequence[FieldError] = (),
        headers: Mapping[str, str] | None = None,
        extra: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__(KINDS[code].status, detail, headers)
        self.code = code
        self.errors = errors
        self.extra = extra or {}


Refusal = ProblemError | DynamicTreeError | JobsError
"""What a route may raise on purpose."""

REFUSALS = get_args(Refusal)


def problem_body(
    code: str, detail: str, *, request_id: str | None, errors: Sequence[FieldError] = ()
) -> dict[str, object]:
    """The problem object of a code."""
    kind = KINDS[code]
    return {
        "type": TYPE_PREFIX + code,
        "title": kind.title,
        "status": kind.status,
        "detail": detail,
        "code": code,
        "request_id": request_id,
        "retryable": kind.retryable,
        "suggestion": kind.suggestion,
        "errors": list(errors),
    }


def problem_response(
    code: str,
    detail: str,
    *,
    request_id: str | None,
    errors: Sequence[FieldError] = (),
    headers: Mapping[str, str] | None = None,
    extra: Mapping[str, object] | None = None,
) -> Response:
    """Response with a problem object."""
    body = problem_body(code, detail, request_id=request_id, errors=errors) | dict(extra or {})
    sent = dict(headers or {})
    if KINDS[code].status in {429, 503}:
        sent.setdefault("Retry-After", "5")
    return Response(orjson.dumps(body), KINDS[code].status, sent, MEDIA_TYPE)


def wrong_field(pointer: str, code: str, detail: str) -> ProblemError:
    """A request of which one field is wrong; `pointer` as RFC 6901 into the body, or where:name."""
    errors: list[FieldError] = [{"pointer": pointer, "code": code, "detail": detail}]
    return ProblemError("validation-failed", detail, errors=errors)


def problem_of(error: Refusal) -> ProblemError:
    """Problem of one of our exceptions. The cause is logged if the client cannot correct it."""
    if isinstance(error, ProblemError):
        return error
    code = problem_code(error)
    if KINDS[code].status == 500:
        logger.error("request failed", exc_info=error)
        return ProblemError(code, "The cause was logged.")
    return ProblemError(code, str(error))


def problem_code(error: Exception) -> str:
    """The code of an exception of ours, or `internal-error`."""
    code = getattr(error, "code", "internal-error") if isinstance(error, DynamicTreeError | JobsError) else None
    return code if code in KINDS else "internal-error"


def request_id_of(scope: Scope) -> str | None:
    """The id that the outermost middleware gave a request."""
    value: str | None = scope.get(REQUEST_ID)
    return value
