"""Middleware around every request: id, security headers, measurement, audit, body limit, unexpected exceptions."""

import asyncio
import logging
import re
import time

from prometheus_client import Counter, Histogram
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jobs.logging_setup import log_ids
from jobs.settings import Settings
from jobs.store import new_id
from service.http.caller import ANYONE, CALLER
from service.http.problems import ADDED_HEADERS, REQUEST_ID, ProblemError, request_id_of

logger = logging.getLogger(__name__)
audit = logging.getLogger("dynamictree.audit")
"""Audit log of changes and of refused keys. It holds ids and names, never a key or a file's content."""

REQUEST_SECONDS = Histogram(
    "dynamictree_request_seconds",
    "Requests by route, until the last byte of the answer",
    ["method", "route"],
    registry=None,
    buckets=(0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10, 60),
)
ANSWERS = Counter("dynamictree_answers", "Answers by status", ["status"], registry=None)

SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
API_VERSION = "1.3"
"""Version of the HTTP API, not of the program. Each addition raises the second number: docs/api-changes.md."""

TUS_VERSION = "1.0.0"
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,128}")
_TRACE_CONTEXT = re.compile(r"[0-9a-f]{2}-[0-9a-f]{32}-[0-9a-f]{16}-[0-9a-f]{2}")


class RequestFrame:
    """Outermost middleware: request id, headers, problem object for unhandled exceptions, metrics, audit log."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Run one request, then measure and log it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        sent = Headers(scope=scope)
        given, traced = sent.get("x-request-id", ""), _TRACE_CONTEXT.fullmatch(sent.get("traceparent", ""))
        request_id = given if _REQUEST_ID.fullmatch(given) else new_id()
        scope[REQUEST_ID] = request_id
        began = time.perf_counter()
        status, location = 0, ""

        async def send_framed(message: Message) -> None:
            nonlocal status, location
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(scope.get(ADDED_HEADERS, {}))
                _add_headers(headers, scope["path"], request_id)
                if traced:
                    headers["traceparent"] = traced.group()
                status, location = message["status"], headers.get("location", "")
            await send(message)

        try:
            with log_ids(request_id=request_id):
                await self.app(scope, receive, send_framed)
        except Exception:
            # every exception must get a response; its message appears only in the log
            logger.exception("request failed", extra={"request_id": request_id, "path": scope["path"]})
            if status:
                raise
            response = ProblemError("internal-error", "The cause was logged.").response(scope)
            await response(scope, receive, send_framed)
        finally:
            route = getattr(scope.get("route"), "path", "none")  # unknown paths share one label
            method = "none" if route == "none" else scope["method"]
            REQUEST_SECONDS.labels(method, route).observe(time.perf_counter() - began)
            ANSWERS.labels(str(status or "none")).inc()
            _audit(scope, status, location)


def _add_headers(headers: MutableHeaders, path: str, request_id: str) -> None:
    headers["X-Request-Id"] = request_id
    if path.startswith("/v1/"):
        headers["X-Api-Version"] = API_VERSION
    if path.startswith("/v1/uploads"):
        headers["Tus-Resumable"] = TUS_VERSION
    for name, value in SECURITY_HEADERS.items():
        headers.setdefault(name, value)
    if "frame-ancestors 'none'" not in headers["Content-Security-Policy"]:
        del headers["X-Frame-Options"]  # this header cannot list origins


def _audit(scope: Scope, status: int, location: str) -> None:
    """Log a change or a refused key. Pushes and pieces of an upload are not logged: they change nothing permanent."""
    path, method = scope["path"], scope["method"]
    changes = method in {"POST", "PUT", "PATCH", "DELETE"} and not path.startswith(("/v1/interact", "/v1/uploads/"))
    if not path.startswith("/v1/") or not (changes or status in {401, 403}):
        return
    caller, client = scope.get(CALLER, ANYONE), scope.get("client")
    event = {
        "actor": caller.key_id or "anyone",
        "target": location or path[:200],
        "outcome": status,
        "owner": caller.owner or "",
        "address": client[0] if client else "",
        "request_id": request_id_of(scope),
    }
    action = f"{method} {getattr(scope.get('route'), 'path', path[:200])}"
    audit.info("%s: %s", action, " ".join(f"{name}={value}" for name, value in event.items()), extra=event)


class BodyLimit:
    """Middleware that refuses a body that stalls or is too large for its route, whatever its Content-Length."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app = app
        self.settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count the bytes of one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        sent = Headers(scope=scope)
        limit, declared = _body_limit(scope["path"], sent, self.settings), sent.get("content-length", "0")
        if not declared.isdecimal() or int(declared) > limit:
            detail = f"the body has {declared} bytes; at most {limit:,} are allowed here"
            refusal = ProblemError("payload-too-large", detail, headers={"Connection": "close"})
            await refusal.response(scope)(scope, receive, send)
            return
        counted, whole = 0, False

        async def receive_counted() -> Message:
            nonlocal counted, whole
            if whole:  # the next message can only be a disconnect, so it has no timeout
                return await receive()
            try:
                async with asyncio.timeout(self.settings.upload_idle_s):
                    message = await receive()
            except TimeoutError as error:
                waited = f"no byte of the body came for {self.settings.upload_idle_s:g} s"
                raise ProblemError("request-timeout", waited, headers={"Connection": "close"}) from error
            if message["type"] != "http.request":
                return message
            counted += len(message.get("body", b""))
            if counted > limit:
                detail = f"the body has more than {limit:,} bytes, which are allowed here"
                raise ProblemError("payload-too-large", detail, headers={"Connection": "close"})
            whole = not message.get("more_body", False)
            return message

        await self.app(scope, receive_counted, send)


def _body_limit(path: str, sent: Headers, settings: Settings) -> int:
    """Return the largest allowed body of a route [bytes]."""
    if path == "/v1/assets" and not sent.get("content-type", "").startswith("application/json"):
        return settings.max_multipart_bytes
    if path == "/v1/uploads" or path.startswith("/v1/uploads/"):
        return settings.max_upload_bytes
    if path.startswith("/v1/interact"):
        return settings.max_interact_bytes
    return settings.max_json_bytes
