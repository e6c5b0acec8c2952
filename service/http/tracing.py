"""A tracing span around every request; the job that it creates continues the trace."""

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jobs.tracing import span, traceparent, tracer


class Traced:
    """Begin a span, and put its name where the client's was."""

    def __init__(self, app: ASGIApp, endpoint: str) -> None:
        self.app = app
        self.endpoint = endpoint

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Trace one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        from opentelemetry.trace import SpanKind

        given = Headers(scope=scope).get("traceparent")
        with span(tracer(self.endpoint, "api"), scope["method"], parent=given, kind=SpanKind.SERVER) as begun:

            async def send_seen(message: Message) -> None:
                if message["type"] == "http.response.start":
                    begun.set_attribute("http.response.status_code", message["status"])
                await send(message)

            headers = MutableHeaders(scope=scope)
            headers["traceparent"] = traceparent(begun)
            try:
                await self.app(scope, receive, send_seen)
            finally:
                route = getattr(scope.get("route"), "path", None)
                if route is not None:
                    begun.update_name(f"{scope['method']} {route}")
                    begun.set_attribute("http.route", route)
