"""Additions to FastAPI's OpenAPI document: tags, keys, examples, and tuples that all tools can read."""

from collections.abc import Iterator, Sequence
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute

from service.http.routing import refusals_of

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
    for parameter in operation.get("parameters", ()):  # no header and no query can be null
        kinds = [kind for kind in parameter["schema"].pop("anyOf", ()) if kind.get("type") != "null"]
        parameter["schema"] |= kinds[0] if len(kinds) == 1 else {"anyOf": kinds} if kinds else {}
    for status, response in operation["responses"].items():
        names = ["X-Request-Id", "traceparent", *(["Retry-After"] if status in ("429", "503") else [])]
        names += ["RateLimit", "RateLimit-Policy"] if status == "429" else []
        own = response.setdefault("headers", {})
        for name in names:
            own.setdefault(name, {"$ref": f"#/components/headers/{name}"})
    if operation["operationId"] in REQUESTS:
        content = operation["requestBody"]["content"]["application/json"]
        content["examples"] = REQUESTS[operation["operationId"]]


def _nodes(node: object) -> Iterator[Page]:
    """Iterate over every object in the document."""
    if isinstance(node, dict):
        yield node
        for child in node.values():
            yield from _nodes(child)
    elif isinstance(node, list):
        for child in node:
            yield from _nodes(child)


_ASSET, _FILE, _SPECTRUM = (f"01M0TREE{what:0>18}" for what in ("ASSET", "F11E", "SPECTR0M"))
_SHA = "9f2c1e" + "0" * 58

_ANIMATE = {
    "type": "animate",
    "asset_id": _ASSET,
    "seed": 7,
    "params": {"wind": {"speed_m_s": 6.0, "direction_deg": 90.0, "gust": 0.3}, "formats": ["glb", "png"]},
}
_PUSH = {
    "spectrum_id": _SPECTRUM,
    "forces": [{"kind": "impulse", "at": {"voxel": 4711}, "impulse_n_s": [0.0, 5.0, 0.0], "duration_s": 0.1}],
    "num_frames": 120,
}
_PULL_AND_RELEASE = {
    "spectrum_id": _SPECTRUM,
    "forces": [
        {"kind": "drag", "at": {"point_m": [0.4, 0.0, 7.9]}, "displacement_m": [0.0, 0.3, 0.0], "duration_s": 0.5}
    ],
    "start": "held",
    "num_frames": 240,
}

_HOOK = {"url": "https://example.com/hook", "events": ["job.first-artifact", "job.succeeded", "job.failed"]}
_ENDPOINT = {"all": {"summary": "Told of every job", "value": _HOOK}}

REQUESTS: dict[str, dict[str, Any]] = {
    "createJob": {
        "animate": {"summary": "A tree that sways, as GLB and a picture", "value": _ANIMATE},
        "diffuse": {"summary": "The spectrum alone", "value": {"type": "diffuse", "asset_id": _ASSET, "seed": 7}},
        "voxelize": {"summary": "The voxels alone", "value": {"type": "voxelize", "asset_id": _ASSET}},
        "reconstruct": {"summary": "A mesh of photos", "value": {"type": "reconstruct", "asset_id": _ASSET}},
    },
    "createAsset": {
        "uploads": {"summary": "Of uploads that are whole", "value": {"upload_ids": [_FILE]}},
        "address": {"summary": "From an address", "value": {"url": "https://example.com/tree.glb", "sha256": _SHA}},
    },
    "interact": {
        "knock": {"summary": "A knock against a branch", "value": _PUSH},
        "pull": {"summary": "Pull a branch aside, hold it, let go", "value": _PULL_AND_RELEASE},
    },
    "createLink": {"hour": {"summary": "For an hour", "value": {"path": f"/v1/artifacts/{_FILE}", "expires_s": 3600}}},
    "createWebhookEndpoint": _ENDPOINT,
}
"""Example bodies by operation id."""
