"""Exceptions of the client.

ClientError
├── ProblemError              the service answered with a problem (RFC 9457), in `problem`
│   ├── InvalidRequestError   correct the request or the input: 400, 405, 406, 411 to 417, 422, 428
│   ├── AccessError           the key is missing, wrong or not permitted: 401, 403
│   ├── NotFoundError         404
│   ├── ConflictError         the state of the resource forbids the operation: 409
│   ├── GoneError             410
│   ├── TooBusyError          try again after `retry_after_s`: 408, 423, 425, 429, 503
│   └── ServiceFaultError     the service failed: 500 and above
├── UnreachableError          the service cannot be reached, or the connection broke
├── JobEndedError             a job did not succeed; `job` is the job, its `error` the reason
├── WaitTimeoutError          a job did not end in time
└── IntegrityError            bytes differ from those that the service announced
"""

from typing import Any

import httpx

from dynamictree_client.models import Job, Problem


class ClientError(Exception):
    """Base class of the client's exceptions."""


class ProblemError(ClientError):
    """The service answered with a problem."""

    def __init__(self, problem: Problem, response: httpx.Response) -> None:
        super().__init__(f"{problem.code}: {problem.detail} {problem.suggestion}".strip())
        self.problem = problem
        self.response = response

    @property
    def code(self) -> str:
        """Return the problem's code, such as `not-found`."""
        return self.problem.code

    @property
    def retry_after_s(self) -> float | None:
        """Return the time after which the service asks for a retry [s]."""
        from dynamictree_client.retries import retry_after_s

        return retry_after_s(self.response)


class InvalidRequestError(ProblemError):
    """The request or the input is wrong."""


class AccessError(ProblemError):
    """The key is missing, wrong or not permitted."""


class NotFoundError(ProblemError):
    """The resource does not exist."""


class ConflictError(ProblemError):
    """The state of the resource forbids the operation."""


class GoneError(ProblemError):
    """The resource has expired or was deleted."""


class TooBusyError(ProblemError):
    """The service is busy; try again later."""


class ServiceFaultError(ProblemError):
    """The service failed."""


class UnreachableError(ClientError):
    """The service cannot be reached, or the connection broke."""


class JobEndedError(ClientError):
    """A job did not succeed."""

    def __init__(self, job: Job) -> None:
        why = f": {job.error.code}: {job.error.detail} {job.error.suggestion}" if job.error else ""
        super().__init__(f"job {job.id} {job.state}{why}")
        self.job = job


class WaitTimeoutError(ClientError):
    """A job did not end in time; it continues on the service."""


class IntegrityError(ClientError):
    """Bytes differ from those that the service announced."""


_BY_STATUS: dict[int, type[ProblemError]] = {
    401: AccessError,
    403: AccessError,
    404: NotFoundError,
    408: TooBusyError,
    409: ConflictError,
    410: GoneError,
    423: TooBusyError,
    425: TooBusyError,
    429: TooBusyError,
    503: TooBusyError,
}


def problem_of(response: httpx.Response) -> ProblemError:
    """Return the exception for a response; a proxy's error page becomes a problem too."""
    status = response.status_code
    kind = _BY_STATUS.get(status, ServiceFaultError if status >= 500 else InvalidRequestError)
    if response.headers.get("content-type", "").startswith("application/problem+json"):
        return kind(Problem.model_validate_json(response.content), response)
    fields: dict[str, Any] = {
        "type": "about:blank",
        "title": response.reason_phrase,
        "status": status,
        "detail": f"HTTP {status} {response.reason_phrase} without a problem: {response.text[:200]!r}.",
        "code": f"http-{status}",
        "request_id": None,
        "retryable": status in (502, 503, 504),
        "suggestion": "Is there a proxy between?",
        "errors": [],
    }
    return kind(Problem.model_validate(fields), response)
