"""Heads that never end."""

import asyncio
import threading
import time
from collections.abc import Iterator

import pytest
import uvicorn

from service.http import connections
from service.http.connections import PunctualProtocol


async def answer(scope: object, receive: object, send: object) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})  # type: ignore[operator]
    await send({"type": "http.response.body", "body": b"ok"})  # type: ignore[operator]


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A server that waits for half a second."""
    monkeypatch.setattr(connections, "HEAD_TIMEOUT_S", 0.5)
    config = uvicorn.Config(answer, port=0, http=PunctualProtocol, lifespan="off", log_level="error", ws="none")  # type: ignore[arg-type]
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield server.servers[0].sockets[0].getsockname()[1]
    server.should_exit = True
    thread.join()


def test_a_head_that_does_not_end_is_given_up_and_others_are_not(port: int) -> None:
    async def talk() -> tuple[bytes, bytes, bytes]:
        silent, silent_to = await asyncio.open_connection("127.0.0.1", port)
        slow, slow_to = await asyncio.open_connection("127.0.0.1", port)
        steady, steady_to = await asyncio.open_connection("127.0.0.1", port)
        slow_to.write(b"GET / HTTP/1.1\r\nHost: a\r\nX: ")
        steady_to.write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
        answered = await steady.readuntil(b"ok")
        await asyncio.sleep(0.8)  # longer than a head may take: between requests it does not count
        steady_to.write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
        again = await steady.readuntil(b"ok")
        ended = await asyncio.wait_for(slow.read(), 5) + await asyncio.wait_for(silent.read(), 5)
        steady_to.write(b"GET / HTTP/1.1\r\n")
        assert await asyncio.wait_for(steady.read(), 5) == b""
        for writer in (silent_to, slow_to, steady_to):
            writer.close()
            await writer.wait_closed()
        return answered, again, ended

    answered, again, ended = asyncio.run(talk())
    assert answered.startswith(b"HTTP/1.1 200")
    assert again.startswith(b"HTTP/1.1 200")
    assert ended == b""
