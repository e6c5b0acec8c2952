"""What one connection may hold: time, head, body, buffer; and how many one address may open."""

import asyncio
import threading
import time
from collections.abc import Iterator

import pytest
import uvicorn

from service.http import connections
from service.http.connections import BoundedProtocol

LARGE = 64 * 1024**2


async def answer(scope: dict[str, object], receive: object, send: object) -> None:
    if scope["path"] == "/large":
        await send({"type": "http.response.start", "status": 200, "headers": []})  # type: ignore[operator]
        await send({"type": "http.response.body", "body": bytes(LARGE)})  # type: ignore[operator]
        return
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})  # type: ignore[operator]
    await send({"type": "http.response.body", "body": b"ok"})  # type: ignore[operator]


@pytest.fixture
def port() -> Iterator[int]:
    """A server of this process."""
    config = uvicorn.Config(answer, port=0, http=BoundedProtocol, lifespan="off", log_level="error", ws="none")  # type: ignore[arg-type]
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield server.servers[0].sockets[0].getsockname()[1]
    server.should_exit = True
    thread.join()


def test_a_head_that_does_not_end_is_given_up_and_others_are_not(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    request = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"

    async def talk() -> None:
        steady, steady_to = await asyncio.open_connection("127.0.0.1", port)
        steady_to.write(request)
        assert (await steady.readuntil(b"ok")).startswith(b"HTTP/1.1 200")
        monkeypatch.setattr(connections, "HEAD_TIMEOUT_S", 0.2)
        silent, silent_to = await asyncio.open_connection("127.0.0.1", port)
        slow, slow_to = await asyncio.open_connection("127.0.0.1", port)
        slow_to.write(request[:-4] + b"\r\nX: ")
        assert await slow.read() + await silent.read() == b""
        steady_to.write(request)  # a pause between requests may be longer than a head may take
        assert (await steady.readuntil(b"ok")).startswith(b"HTTP/1.1 200")
        steady_to.write(request[:-2])
        assert await steady.read() == b""
        for writer in (silent_to, slow_to, steady_to):
            writer.close()
            await writer.wait_closed()

    asyncio.run(asyncio.wait_for(talk(), 60))


async def all_closed() -> None:
    """Wait until the server has closed every connection."""
    async with asyncio.timeout(60):
        while BoundedProtocol.per_address:
            await asyncio.sleep(0.01)


def exchange(port: int, *pieces: bytes, wait_s: float = 5.0) -> bytes:
    """Send pieces to the server; all that it answers until it closes the connection."""

    async def talk() -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            for piece in pieces:
                writer.write(piece)
                await writer.drain()
        except ConnectionError:
            pass  # refused before all was sent
        try:
            return await asyncio.wait_for(reader.read(), wait_s)
        except ConnectionError:
            return b"reset"
        finally:
            writer.transport.abort()

    return asyncio.run(talk())


@pytest.mark.parametrize(
    "head",
    [
        b"GET / HTTP/1.1\r\n" + b"a:b\r\n" * 1000 + b"\r\n",
        b"GET / HTTP/1.1\r\nX: " + b"a" * 300_000 + b"\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"".join(b"X%d: %s\r\n" % (n, b"a" * 2000) for n in range(50)) + b"\r\n",
        b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\nHost: a\r\n\r\n",
        b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n1\r\na\r\n0\r\n" + b"T: " + b"a" * 300_000,
    ],
    ids=["many", "long", "sum", "target", "trailer"],
)
def test_a_head_has_a_bound(port: int, head: bytes) -> None:
    answered = exchange(port, head)
    assert answered.startswith((b"HTTP/1.1 431", b"HTTP/1.1 200", b"reset"))  # a trailer comes after the answer
    assert b"431" in answered or answered == b"reset"


def test_a_refused_body_keeps_no_connection(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "UNREAD_TIMEOUT_S", 0.3)
    answered = exchange(port, b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 100\r\n\r\n", b"x")
    assert answered.startswith(b"HTTP/1.1 200")


def test_an_address_has_so_many_connections(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "MAX_PER_ADDRESS", 3)

    async def talk() -> list[bytes]:
        opened = [await asyncio.open_connection("127.0.0.1", port) for _ in range(4)]
        refused = await asyncio.wait_for(opened[3][0].read(), 5)
        for _, writer in opened:
            writer.transport.abort()
        await all_closed()
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
        answered = await reader.readuntil(b"ok")
        writer.transport.abort()
        return [refused, answered]

    refused, answered = asyncio.run(talk())
    assert refused.startswith(b"HTTP/1.1 503")
    assert answered.startswith(b"HTTP/1.1 200")


def test_a_reader_that_stalls_is_let_go(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    async def received(*, stalls: bool) -> int:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024)
        writer.write(b"GET /large HTTP/1.1\r\nHost: a\r\n\r\n")
        if stalls:
            while not BoundedProtocol.per_address:
                await asyncio.sleep(0.01)
            await all_closed()
        size = 0
        try:
            while size < LARGE and (piece := await asyncio.wait_for(reader.read(2**20), 60)):
                size += len(piece)
        except ConnectionError:
            pass
        finally:
            writer.transport.abort()
        return size

    assert asyncio.run(received(stalls=False)) >= LARGE
    asyncio.run(all_closed())
    monkeypatch.setattr(connections, "STALL_S", 0.2)
    assert asyncio.run(received(stalls=True)) < LARGE
