"""A real HTTP server on loopback that answers, or fails, as a test wants."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class ReceivedRequest:
    """One request that came in."""

    method: str
    path: str
    headers: dict[str, str]
    body: bytes


@dataclass
class Line:
    """Answers come from `answer(number of the request, handler)`; `asked` tells what was asked."""

    answer: Callable[[int, "Handler"], None]
    requests: list[ReceivedRequest] = field(default_factory=list)
    url: str = ""


class Handler(BaseHTTPRequestHandler):
    line: Line
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        self.body = self.rfile.read(int(self.headers.get("content-length", 0)))
        headers = {name.lower(): value for name, value in self.headers.items()}
        self.line.requests.append(ReceivedRequest(self.command, self.path, headers, self.body))
        self.line.answer(len(self.line.requests), self)

    do_POST = do_PATCH = do_HEAD = do_GET  # noqa: N815 - http.server's names

    def log_message(self, format: str, *arguments: object) -> None:
        pass

    def reply(self, status: int, body: bytes, media_type: str = "application/json", **headers: str) -> None:
        self.send_response(status)
        for name, value in ({"Content-Type": media_type, "Content-Length": str(len(body))} | headers).items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(body)

    def problem(self, status: int, code: str, **headers: str) -> None:
        body = {"type": f"urn:dynamictree:problem:{code}", "title": "t", "status": status, "detail": "d", "code": code}
        body |= {"request_id": None, "retryable": status == 503, "suggestion": "s", "errors": []}
        self.reply(status, json.dumps(body).encode(), "application/problem+json", **headers)

    def break_off(self, body: bytes, announced: int, status: int = 200) -> None:
        """Announce more than is sent, and hang up."""
        self.send_response(status)
        self.send_header("Content-Length", str(announced))
        self.end_headers()
        self.wfile.write(body)
        self.wfile.flush()
        self.close_connection = True


@contextmanager
def answering(answer: Callable[[int, Handler], None]) -> Iterator[Line]:
    line = Line(answer=answer)
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Bound", (Handler,), {"line": line}))
    server.daemon_threads = True
    line.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield line
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
