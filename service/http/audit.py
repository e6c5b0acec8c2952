"""Log every change that a request made, and every refused key, on a channel of its own."""

import logging

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.http.caller import ANYONE, CALLER
from service.http.problems import request_id_of

audit = logging.getLogger("dynamictree.audit")
"""Ids and names only: never a key, a secret or a file's content."""

CHANGING = frozenset({"POST", "PUT", "PATCH", "DELETE"})
QUIET = ("/v1/interact", "/v1/uploads/")
"""Pushes, and pieces of an upload, change nothing that outlives them; an upload's creation is written."""

REFUSED = frozenset({401, 403})


class Audited:
    """Middleware around authentication, which provides the caller once the request has passed."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Run one request, then log it."""
        if scope["type"] != "http" or not scope["path"].startswith("/v1/"):
            await self.app(scope, receive, send)
            return
        status, location = 0, ""

        async def send_seen(message: Message) -> None:
            nonlocal status, location
            if message["type"] == "http.response.start":
                status = message["status"]
                locations = [value for name, value in message["headers"] if name.lower() == b"location"]
                location = locations[0].decode("latin-1") if locations else ""
            await send(message)

        try:
            await self.app(scope, receive, send_seen)
        finally:
            changes = scope["method"] in CHANGING and not scope["path"].startswith(QUIET)
            if status in REFUSED or changes:
                _write(scope, status, location)


def _write(scope: Scope, status: int, location: str) -> None:
    caller = scope.get(CALLER, ANYONE)
    client = scope.get("client")
    action = f"{scope['method']} {getattr(scope.get('route'), 'path', scope['path'][:200])}"
    event = {
        "actor": caller.key_id or "anyone",
        "target": location or scope["path"][:200],
        "outcome": status,
        "owner": caller.owner or "",
        "address": client[0] if client else "",
        "request_id": request_id_of(scope),
    }
    audit.info("%s: %s", action, " ".join(f"{name}={value}" for name, value in event.items()), extra=event)
