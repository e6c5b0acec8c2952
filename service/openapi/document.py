"""Additions to FastAPI's OpenAPI document: tags, keys, examples, and tuples that all tools can read."""

from collections.abc import Iterator, Sequence
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute

from service.http.routing import refusals_of
from service.openapi.examples import REQUESTS

DESCRIPTION = """\
Upload a tree (a mesh, photos, a Gaussian splat or a scan), create a job, download its motion, apply forces.

Lengths are metres, +Z is up, times are seconds, unless a name says otherwise. Errors are problem objects (RFC 9457)
with a stable `code`; if a request can be sent again, `Retry-After` states when."""

TAGS = [
    {"name": "uploads", "description": "Resumable uploads by the tus protocol, version 1.0."},
    {"name": "assets", "description": "Inputs of jobs: meshes, photos, splats, scans."},
    {"name": "jobs", "description": "Jobs, whose stages run in order: reconstruct, voxelize, diffuse, animate."},
    {"name": "artifacts", "description": "Files that jobs produce."},
    {"name": "spectra", "description": "Spectra of trees, and data for viewers: surface, modes, wind."},
    {"name": "interact", "description": "Response of a tree to forces; stateless."},
    {"name": "webhooks", "description": "Endpoints that receive events of jobs."},
    {"name": "events", "description": "Events that endpoints receive."},
    {"name": "catalogue", "description": "Models, limits and resource use."},
    {"name": "health", "description": "Probes of liveness and readiness."},
]
KEY = {"type": "http", "scheme": "bearer", "description": "API key, if the service requires one"}
AUTH_PROBLEMS = ("unauthorized", "forbidden", "rate-limited")  # problems of the authentication under /v1
LICENSE = {"name": "Apache License 2.0", "identifier": "Apache-2.0"}
CONTACT = {"name": "The maintainers of DynamicTree"}
HEADERS = {
    "X-Request-Id": "id of the request, as it was sent or made here; the log names it",
    "traceparent": "W3C trace context of the request, where it was sent with one",
    "Retry-After": "seconds until the request may succeed",
    "RateLimit": "what is left of the rate, and until when (IETF draft)",
    "RateLimit-Policy": "the rate of the key (IETF draft)",
}
SERVERS = [{"url": "/", "description": "This server"}]

Page = dict[str, Any]


def operation_id(route: APIRoute) -> str:
    """Return the id of an operation: the name of its function in camel case."""
    first, *others = route.name.strip("_").split("_")
    return first + "".join(word.title() for word in others)


def described(app: FastAPI) -> Page:
    """Return the application's OpenAPI document, with examples, and with tuples that every reader understands."""
    if app.openapi_schema is None:
        page = FastAPI.openapi(app)
        for path, item in page["paths"].items():
            for operation in item.values():
                _complete(operation, AUTH_PROBLEMS if path.startswith("/v1") else ())
        components = page["components"]
        for node in _nodes(page):
            if "prefixItems" in node:  # all members of our tuples have one type; older tools support only `items`
                node["items"] = node["prefixItems"][0]
        components["headers"] = {
            name: {"description": text, "schema": {"type": "string"}} for name, text in HEADERS.items()
        }
        components["securitySchemes"] = {"key": KEY}
        page["security"] = [{}, {"key": []}]  # the operator decides whether keys are required
        page["tags"] = TAGS
        app.openapi_schema = page
    return app.openapi_schema


def _complete(operation: Page, doors: Sequence[str]) -> None:
    """Add the problems of the authentication, the headers of every response, and examples of bodies."""
    for status, entry in refusals_of(doors).items():
        response = operation["responses"].setdefault(str(status), entry)
        if response is not entry:
            response["description"] = f"{response['description']}; {entry['description']}"
    for parameter in operation.get("parameters", ()):
        parameter["schema"] = _never_null(parameter["schema"])
    for status, response in operation["responses"].items():
        names = ["X-Request-Id", "traceparent", *(["Retry-After"] if status in ("429", "503") else [])]
        names += ["RateLimit", "RateLimit-Policy"] if status == "429" else []
        own = response.setdefault("headers", {})
        for name in names:
            own.setdefault(name, {"$ref": f"#/components/headers/{name}"})
    if operation["operationId"] in REQUESTS:
        content = operation["requestBody"]["content"]["application/json"]
        content["examples"] = REQUESTS[operation["operationId"]]


def _never_null(schema: Page) -> Page:
    """Remove null from the schema of an optional parameter: no header and no query can be null."""
    kinds = [kind for kind in schema.pop("anyOf", ()) if kind.get("type") != "null"]
    return schema | (kinds[0] if len(kinds) == 1 else {"anyOf": kinds} if kinds else {})


def _nodes(node: object) -> Iterator[Page]:
    """Iterate over every object in the document."""
    if isinstance(node, dict):
        yield node
        for child in node.values():
            yield from _nodes(child)
    elif isinstance(node, list):
        for child in node:
            yield from _nodes(child)
