"""Errors as RFC 9457 problem objects: one shape, one table from code to status.

Functions that refuse a request raise a `Refusal`, which `problem_handlers` answers; docstrings do not repeat that.
"""

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
from jobs.storage.artifacts import is_full

logger = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:dynamictree:problem:"
REQUEST_ID = "dynamictree.request_id"
"""Key under which the outermost middleware stores the request's id in the scope."""

ADDED_HEADERS = "dynamictree.headers"
"""Key under which the authentication stores headers to add to the response."""


@dataclass(frozen=True)
class Kind:
    """Status, title and advice of one problem code."""

    status: int
    title: str
    suggestion: str
    retryable: bool = False


KINDS: dict[str, Kind] = {
    "validation-failed": Kind(422, "The request is not valid", "Mend the fields named in errors."),
    "invalid-input": Kind(422, "The input cannot be used", "Change what detail names."),
    "invalid-geometry": Kind(422, "The geometry cannot be used", "Repair the mesh as detail says; upload it again."),
    "archive-rejected": Kind(422, "The archive is refused", "Send a flat zip of the mesh and the files that it names."),
    "input-too-costly": Kind(422, "The input takes too much to read", "Simplify or decimate it, and upload it again."),
    "numerics-error": Kind(422, "The result is not finite", "Use smaller forces or time steps."),
    "unstable-timestep": Kind(422, "The time step is not stable", "Use at most max_dt_s."),
    "bad-request": Kind(400, "The request cannot be read", "Send well-formed HTTP and JSON."),
    "unauthorized": Kind(401, "A key is needed", "Ask the operator for a key."),
    "forbidden": Kind(403, "That is not allowed", "Ask the operator, or see docs/keys.md."),
    "not-found": Kind(404, "There is no such thing", "Check the id and the path."),
    "method-not-allowed": Kind(405, "The method is not allowed here", "See the Allow header."),
    "not-acceptable": Kind(406, "No such representation", "Accept a media type that detail names."),
    "request-timeout": Kind(408, "The upload stood still", "Send it again on a steady line.", retryable=True),
    "conflict": Kind(409, "The state forbids it", "Look at the state, then decide again."),
    "upload-offset-conflict": Kind(409, "The upload stands elsewhere", "Ask where with HEAD, and go on from there."),
    "precondition-failed": Kind(412, "The protocol is another one", "Speak tus 1.0.0."),
    "checksum-mismatch": Kind(460, "The bytes are not those of the checksum", "Send them again.", retryable=True),
    "fetch-failed": Kind(422, "The address could not be fetched", "Use a public https address, or upload."),
    "quota-exceeded": Kind(429, "Too much is stored", "Delete uploads, or wait until products expire."),
    "too-many-active-jobs": Kind(429, "Too many of your jobs run", "Wait for one to end.", retryable=True),
    "rate-limited": Kind(429, "Too many requests", "Wait as Retry-After says.", retryable=True),
    "idempotency-key-reused": Kind(422, "The key means another request", "Use a new Idempotency-Key."),
    "expired": Kind(410, "It is gone", "Make it again."),
    "payload-too-large": Kind(413, "The body is too large", "See GET /v1/limits."),
    "unsupported-format": Kind(415, "The format is not supported", "See GET /v1/limits for formats."),
    "range-not-satisfiable": Kind(416, "The range is outside", "Ask for bytes below the size."),
    "internal-error": Kind(500, "The service failed", "Try again; report the request_id if it stays.", retryable=True),
    "model-error": Kind(500, "The model cannot be used", "Tell the operator."),
    "overloaded": Kind(503, "Too much is asked at once", "Try again later.", retryable=True),
    "queue-full": Kind(503, "Too many jobs wait", "Try again later.", retryable=True),
    "disk-full": Kind(503, "The storage is full", "Try again later.", retryable=True),
    "storage-unavailable": Kind(503, "A storage is away", "Try again later.", retryable=True),
    # failures of jobs: they appear in the `error` of a job, never as the status of a response
    "canceled": Kind(409, "The job was canceled", "Create it again."),
    "out-of-memory": Kind(500, "Out of memory", "Simplify the input, or ask for less."),
    "time-limit": Kind(500, "The job took too long", "Simplify the input, or ask for less."),
    "worker-lost": Kind(500, "The worker was lost", "Create the job again.", retryable=True),
    "poison-input": Kind(500, "The input takes every worker down", "Simplify the input."),
    "reconstruction-failed": Kind(422, "The photos do not fit together", "Take more photos, with more overlap."),
    "camera-search-failed": Kind(
        500, "The search for cameras failed", "Try again; report the job's id if it stays.", retryable=True
    ),
}


class FieldError(TypedDict):
    """One invalid field of a request."""

    pointer: str
    code: str
    detail: str


class ProblemError(HTTPException):
    """Exception that refuses a request. It is an HTTPException, so that FastAPI's body parser lets it pass."""

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

    def response(self, scope: Scope) -> Response:
        """Return the response to the request of this scope."""
        body = problem_body(self.code, self.detail, request_id=request_id_of(scope), errors=self.errors)
        headers = dict(self.headers or {})
        if self.status_code in {429, 503}:
            headers.setdefault("Retry-After", "5")
        return Response(orjson.dumps(body | dict(self.extra)), self.status_code, headers, MEDIA_TYPE)


Refusal = ProblemError | DynamicTreeError | JobsError
"""Exceptions that routes raise on purpose."""

REFUSALS = get_args(Refusal)


def problem_body(
    code: str, detail: str, *, request_id: str | None, errors: Sequence[FieldError] = ()
) -> dict[str, object]:
    """Return the problem object of a code."""
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


def wrong_field(pointer: str, code: str, detail: str) -> ProblemError:
    """Return the problem of one invalid field; `pointer` is a JSON pointer (RFC 6901) into the body, or where:name."""
    errors: list[FieldError] = [{"pointer": pointer, "code": code, "detail": detail}]
    return ProblemError("validation-failed", detail, errors=errors)


def problem_of(error: Refusal | OSError) -> ProblemError:
    """Return the problem of one of our exceptions, or of a full disk. A cause that clients cannot correct is logged.

    Raises:
        OSError: the error is not a full disk.
    """
    if isinstance(error, ProblemError):
        return error
    if isinstance(error, OSError):
        if not is_full(error):
            raise error
        logger.error("the disk is full", exc_info=error)
        return ProblemError("disk-full", "a file could not grow, since the disk is full; it was not stored")
    code = problem_code(error)
    if KINDS[code].status == 500:
        logger.error("request failed", exc_info=error)
        return ProblemError(code, "The cause was logged.")
    return ProblemError(code, str(error))


def problem_code(error: Exception) -> str:
    """Return the code of one of our exceptions, or `internal-error`."""
    code = getattr(error, "code", "internal-error") if isinstance(error, DynamicTreeError | JobsError) else None
    return code if code in KINDS else "internal-error"


def request_id_of(scope: Scope) -> str | None:
    """Return the id that the outermost middleware gave a request."""
    value: str | None = scope.get(REQUEST_ID)
    return value
