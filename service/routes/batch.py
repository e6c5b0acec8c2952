"""/v1/jobs:batch: several jobs in one request, each accepted or refused by itself."""

from typing import Annotated

from fastapi import APIRouter, Header, Request, Response, status
from pydantic import Field

from service.http.problems import REFUSALS, problem_body, problem_of, request_id_of
from service.http.request_context import Origin, RequestOrigin
from service.http.routing import refusals
from service.job_creation import accept
from service.schemas.base import Payload, Problem
from service.schemas.job_requests import JobRequest
from service.schemas.jobs import JobPayload
from service.services import Owned, OwnedDep

router = APIRouter(prefix="/v1", tags=["jobs"])


class BatchRequest(Payload):
    """Several jobs at once."""

    jobs: list[JobRequest] = Field(min_length=1, max_length=100)


class BatchItemPayload(Payload):
    """Result of one item of a batch: the job, or why it was refused."""

    status: int = Field(description="what the request would have been answered by itself")
    job: JobPayload | None
    problem: Problem | None


class BatchPayload(Payload):
    """Results of a batch, in the order of the request."""

    data: list[BatchItemPayload]


@router.post(
    "/jobs:batch", operation_id="createJobs", status_code=status.HTTP_202_ACCEPTED, responses=refusals("forbidden")
)
def create_jobs(
    body: BatchRequest,
    request: Request,
    owned: OwnedDep,
    origin: Origin,
    idempotency_key: Annotated[
        str | None, Header(min_length=1, max_length=128, description="the same key within 24 h gives the same jobs")
    ] = None,
) -> BatchPayload:
    """Create several jobs. Each is accepted or refused separately, with its own status."""
    return BatchPayload(
        data=[
            _one(
                owned,
                wanted,
                origin,
                None if idempotency_key is None else f"batch:{idempotency_key}:{number}",
                request,
            )
            for number, wanted in enumerate(body.jobs)
        ]
    )


def _one(
    owned: Owned, wanted: JobRequest, origin: RequestOrigin, key: str | None, request: Request
) -> BatchItemPayload:
    try:
        payload = accept(owned, wanted, origin, Response(), key=key)
    except REFUSALS as error:
        refusal = problem_of(error)
        body = problem_body(
            refusal.code, refusal.detail, request_id=request_id_of(request.scope), errors=refusal.errors
        )
        return BatchItemPayload(status=refusal.status_code, job=None, problem=Problem.model_validate(body))
    return BatchItemPayload(status=status.HTTP_202_ACCEPTED, job=payload, problem=None)
