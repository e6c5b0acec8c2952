"""uvicorn's HTTP protocol, with limits on time and memory per connection and on connections per address.

Enabled by uvicorn's option `--http service.http.connections:BoundedProtocol`. uvicorn itself limits only idle
connections, not slow or large request heads (slowloris), bodies that the application does not read, or stalled readers.
"""

import asyncio
import logging
from collections import Counter
from typing import ClassVar

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

logger = logging.getLogger(__name__)

HEAD_TIMEOUT_S = 15.0
"""Time from the connection, or from the first byte of a request, to the end of the request's head [s]."""

REQUEST_TIMEOUT_S = 3600.0
"""Time from the end of a head to the end of its body [s]; a longer upload continues in a new request."""

UNREAD_TIMEOUT_S = 5.0
"""Time for the rest of a body if the response was sent before the body was complete [s]."""

STALL_S = 30.0
"""Interval between checks of a slow reader's write buffer [s]."""

MIN_READ_BYTES = 64 * 1024
"""Bytes that a client must read per `STALL_S`: 2 kB/s."""

MAX_HEAD_BYTES = 64 * 1024
MAX_HEADERS = 100
MAX_PER_ADDRESS = 256
"""Connections per address, unless the application's lifespan state sets another number."""

REFUSAL = b"HTTP/1.1 %s\r\ncontent-type: text/plain; charset=utf-8\r\ncontent-length: %d\r\nconnection: close\r\n\r\n%s"


class BoundedProtocol(HttpToolsProtocol):
    """HTTP protocol that closes connections which take too much time or memory."""

    per_address: ClassVar[Counter[str]] = Counter()  # open connections of this process
    _timer: asyncio.TimerHandle | None = None
    _stall: asyncio.TimerHandle | None = None
    _address: str | None = None
    _body_open = False
    _refused = False
    _head_bytes = 0
    _head_fields = 0
    _unparsed = 0

    # -- connections

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count the connection of this address, and start the timeout for the first head."""
        super().connection_made(transport)
        allowed = self.app_state.get("max_connections_per_address", MAX_PER_ADDRESS)
        self._address = self.client[0] if self.client else None  # None on a unix socket
        if self._address is not None:
            self.per_address[self._address] += 1
            if self.per_address[self._address] > allowed:
                self._refuse(b"503 Service Unavailable", b"Too many connections from this address.")
                return
        self._expect(HEAD_TIMEOUT_S)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop every timer."""
        self._expect(None)
        self._watch_writing(None)
        if self._address is not None:
            self.per_address[self._address] -= 1
            if self.per_address[self._address] <= 0:
                del self.per_address[self._address]
            self._address = None
        super().connection_lost(exc)

    # -- requests

    def data_received(self, data: bytes) -> None:
        """Parse received bytes; refuse a header field that is too large."""
        if self._refused:
            return
        self._unparsed += len(data)
        super().data_received(data)
        if self._unparsed > MAX_HEAD_BYTES and not self._refused:
            self._refuse(b"431 Request Header Fields Too Large", b"A header has more than 64 KiB.")

    def on_message_begin(self) -> None:
        """Start the timeout for the head of the next request."""
        super().on_message_begin()
        self._head_bytes = self._head_fields = self._unparsed = 0
        self._body_open = True
        if self._timer is None:
            self._expect(HEAD_TIMEOUT_S)

    def on_url(self, url: bytes) -> None:
        """Count the bytes of the request target."""
        self._head_bytes += len(url)
        self._bound_head()
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Count a header or trailer field and its bytes."""
        self._unparsed = 0
        self._head_bytes += len(name) + len(value)
        self._head_fields += 1
        self._bound_head()
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Start the timeout for the end of the body."""
        self._unparsed = 0
        self._expect(REQUEST_TIMEOUT_S)
        if not self._refused:
            super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Receive a part of the body."""
        self._unparsed = 0
        super().on_body(body)

    def on_message_complete(self) -> None:
        """Stop the timeout: the request is complete."""
        self._unparsed = 0
        self._body_open = False
        self._expect(None)
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Start a short timeout for the rest of a body that is no longer read."""
        super().on_response_complete()
        if self._body_open and not self.transport.is_closing():
            self._expect(UNREAD_TIMEOUT_S)

    def _bound_head(self) -> None:
        if self._head_bytes > MAX_HEAD_BYTES or self._head_fields > MAX_HEADERS:
            reason = b"At most %d headers of %d bytes in all are allowed." % (MAX_HEADERS, MAX_HEAD_BYTES)
            self._refuse(b"431 Request Header Fields Too Large", reason)
            raise ValueError(reason)  # stops the parser

    def send_400_response(self, msg: str) -> None:
        """Send status 400, unless the connection was refused already."""
        if not self._refused:
            super().send_400_response(msg)

    # -- responses

    def pause_writing(self) -> None:
        """Start to check whether the client is still reading."""
        super().pause_writing()
        self._watch_writing(self.transport.get_write_buffer_size())

    def resume_writing(self) -> None:
        """Stop the check: the client has read."""
        super().resume_writing()
        self._watch_writing(None)

    def _watch_writing(self, size: int | None) -> None:
        if self._stall is not None:
            self._stall.cancel()
        self._stall = None if size is None else self.loop.call_later(STALL_S, self._require_progress, size)

    def _require_progress(self, before: int) -> None:
        now = self.transport.get_write_buffer_size()
        if before - now < MIN_READ_BYTES:
            logger.info("a client reads too slowly; its connection is closed", extra={"unread_bytes": now})
            self.transport.abort()
            return
        self._watch_writing(now)

    # -- timeouts and refusals

    def _expect(self, within_s: float | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None if within_s is None else self.loop.call_later(within_s, self._give_up)

    def _give_up(self) -> None:
        self._timer = None
        if not self.transport.is_closing():
            self.transport.close()

    def _refuse(self, status: bytes, detail: bytes) -> None:
        self._refused = True
        self.transport.write(REFUSAL % (status, len(detail), detail))
        self.transport.close()
