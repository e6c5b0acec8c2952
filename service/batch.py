"""/v1/jobs:batch: several jobs in one request, each accepted or refused by itself."""

from typing import Annotated

from fastapi import APIRouter, Header, Request, Response, status
from starlette.exceptions import HTTPException

from dynamictree.errors import DynamicTreeError
from jobs.errors import JobsError
from service.context import Context, Ctx
from service.jobs import KEY_EXPIRES_S, accept
from service.origin import Origin, RequestOrigin
from service.payloads import BatchItemPayload, BatchPayload, BatchRequest, JobRequest, Problem
from service.problems import KINDS, ProblemError, known_code, problem_body, request_id_of
from service.routing import refusals

router = APIRouter(prefix="/v1", tags=["jobs"])


@router.post(
    "/jobs:batch", operation_id="createJobs", status_code=status.HTTP_202_ACCEPTED, responses=refusals("forbidden")
)
def create_jobs(
    body: BatchRequest,
    request: Request,
    context: Ctx,
    origin: Origin,
    idempotency_key: Annotated[
        str | None, Header(min_length=1, max_length=128, description="the same key within 24 h gives the same jobs")
    ] = None,
) -> BatchPayload:
    """Ask for several products. One that is refused keeps none of the others; each tells its own status."""
    return BatchPayload(
        data=[
            _one(
                context,
                wanted,
                origin,
                None if idempotency_key is None else f"batch:{idempotency_key}:{number}",
                request,
            )
            for number, wanted in enumerate(body.jobs)
        ]
    )


def _one(
    context: Context, wanted: JobRequest, origin: RequestOrigin, key: str | None, request: Request
) -> BatchItemPayload:
    try:
        made = accept(context, wanted, origin, Response(), key=key, expires_s=KEY_EXPIRES_S)
    except (ProblemError, DynamicTreeError, JobsError) as error:
        code = error.code if isinstance(error, ProblemError) else known_code(error)
        detail = str(error.detail) if isinstance(error, HTTPException) else str(error)
        errors = error.errors if isinstance(error, ProblemError) else ()
        told = problem_body(code, detail, request_id=request_id_of(request), errors=errors)
        return BatchItemPayload(status=KINDS[code].status, job=None, problem=Problem.model_validate(told))
    return BatchItemPayload(status=status.HTTP_202_ACCEPTED, job=made, problem=None)
