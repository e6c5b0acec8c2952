"""Exception handlers that turn the exceptions of routes into problem responses."""

import logging

import sqlalchemy as sa
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Route

from dynamictree.errors import DynamicTreeError
from jobs.errors import JobsError
from service.http.problems import ProblemError, Refusal, problem_of
from service.http.validation_errors import MAX_VALUE_CHARS, invalid_fields

logger = logging.getLogger(__name__)

_BY_STATUS = {400: "bad-request", 413: "payload-too-large", 422: "validation-failed"}


def install(app: FastAPI) -> None:
    """Install a handler for each exception type that a route may raise; the middleware answers all others."""
    app.add_exception_handler(HTTPException, _on_http)
    for ours in (DynamicTreeError, JobsError, OSError, RequestValidationError):
        app.add_exception_handler(ours, _on_ours)
    app.add_exception_handler(sa.exc.OperationalError, _on_database_away)


async def _on_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    problem = error if isinstance(error, ProblemError) else _problem_of_framework(request, error)
    return problem.response(request.scope)


def _problem_of_framework(request: Request, error: HTTPException) -> ProblemError:
    """Return the problem for a refusal by Starlette or FastAPI."""
    path = request.scope["path"][:MAX_VALUE_CHARS]
    if error.status_code == 404:
        return ProblemError("not-found", f"there is nothing at {path!r}; /openapi.json tells every path")
    if error.status_code == 405:
        allowed = ", ".join(_methods(request))
        detail = f"{request.method} is not allowed at {path!r}; {allowed} are"
        return ProblemError("method-not-allowed", detail, headers={"Allow": allowed})
    code = _BY_STATUS.get(error.status_code, "bad-request")
    return ProblemError(code, str(error.detail), headers=error.headers)


def _methods(request: Request) -> list[str]:
    """Return the methods of all routes at this path; Starlette reports only those of the first one."""
    path, fitting = request.scope["path"], list[Route]()
    for included in request.app.routes:
        router = getattr(included, "original_router", None)  # FastAPI does not flatten included routers
        routes = [included] if router is None else router.routes
        fitting += [route for route in routes if isinstance(route, Route) and route.path_regex.match(path)]
    own = [route for route in fitting if route.path == path] or fitting
    return sorted(set[str]().union(*(route.methods or () for route in own)))


async def _on_ours(request: Request, error: Exception) -> Response:
    if isinstance(error, RequestValidationError):
        return invalid_fields(error.errors()).response(request.scope)
    assert isinstance(error, Refusal | OSError)
    return problem_of(error).response(request.scope)


async def _on_database_away(request: Request, error: Exception) -> Response:
    logger.error("the database is away", exc_info=error)
    detail = "the database does not answer; nothing was changed"
    return ProblemError("storage-unavailable", detail).response(request.scope)
