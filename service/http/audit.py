"""Write every change that a request made, and every refused key, to the audit log."""

import logging

from starlette.concurrency import run_in_threadpool
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jobs.audit import audit_log
from jobs.settings import Settings
from service.http.caller import ANYONE, CALLER
from service.http.problems import request_id_of

logger = logging.getLogger(__name__)

CHANGING = frozenset({"POST", "PUT", "PATCH", "DELETE"})
QUIET = ("/v1/interact", "/v1/uploads/")
"""Pushes, and pieces of an upload, change nothing that outlives them; an upload's creation is written."""

REFUSED = frozenset({401, 403})


class Audited:
    """Middleware around authentication, which provides the caller once the request has passed."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app = app
        self.log = audit_log(settings.state_dir, settings.audit_log_bytes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Run one request, then write it down."""
        if scope["type"] != "http" or not scope["path"].startswith("/v1/") or self.log.max_bytes == 0:
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
                await run_in_threadpool(self._write, scope, status, location)

    def _write(self, scope: Scope, status: int, location: str) -> None:
        caller = scope.get(CALLER, ANYONE)
        client = scope.get("client")
        try:
            self.log.write(
                f"{scope['method']} {getattr(scope.get('route'), 'path', scope['path'][:200])}",
                actor=caller.key_id or "anyone",
                target=location or scope["path"][:200],
                outcome=str(status),
                owner=caller.owner or "",
                address=client[0] if client else "",
                request_id=request_id_of(scope),
            )
        except OSError:
            logger.exception("the audit log cannot be written")
