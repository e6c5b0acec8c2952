"""Where a stranger may send this service, and where not."""

import asyncio
import socket
from collections.abc import Iterator
from ipaddress import ip_address

import pytest

from jobs.clients.outbound import Outbound, is_public
from jobs.errors import OutboundError
from tests.line import Handler, Line, answering

PRIVATE = (
    *("127.0.0.1", "10.0.0.1", "172.16.0.1", "192.168.1.1", "169.254.169.254", "100.100.100.200", "0.0.0.0"),
    "224.0.0.1",
    *("::1", "::", "fe80::1", "fd00:ec2::254", "::ffff:127.0.0.1", "::ffff:10.0.0.1", "64:ff9b::7f00:1"),
    "2002:7f00:1::",
    *("::10.0.0.1", "::ffff:0:10.0.0.1", "::ffff:169.254.169.254", "64:ff9b::a00:1", "64:ff9b:1::a00:1"),
    "2002:a00:1::1",
    *("2002:c0a8:101::", "fc00::1", "fd12:3456::1", "fe80::5efe:10.0.0.1", "feb0::1", "100::1", "5f00::1", "4000::1"),
    *("2606:4700::5efe:10.0.0.1", "2606:4700::200:5efe:a00:1", "3fff::1", "2001:db8::1", "2001:10::1", "192.88.99.1"),
    *("::ffff:168.63.129.16", "64:ff9b::a83f:8110", "198.19.0.1", "192.0.0.8", "240.0.0.1", "100.127.255.255"),
    *("2001:0:4136:e378:8000:63bf:80ff:fffe", "fec0::1", "ff02::1", "168.63.129.16", "255.255.255.255", "192.0.2.1"),
)


@pytest.mark.parametrize("address", PRIVATE)
def test_an_address_that_is_not_everybodys_is_not_public(address: str) -> None:
    assert not is_public(ip_address(address))


@pytest.mark.parametrize(
    "address",
    [
        *("93.184.216.34", "2606:2800:220:1:248:1893:25c8:1946", "64:ff9b::5db8:d822"),
        *("::ffff:93.184.216.34", "2002:5db8:d822::1"),
    ],
)
def test_an_address_of_the_world_is_public(address: str) -> None:
    assert is_public(ip_address(address))


def resolver(**names: list[str]) -> "tuple[Outbound, list[str]]":
    """A way out with names of our own, and what it looked up."""
    lookups: list[str] = []

    async def look_up(host: str, port: int) -> list[str]:
        lookups.append(host)
        return [names[host.split(".")[0]].pop(0)] if host.split(".")[0] in names else [host]

    return Outbound(look_up=look_up), lookups


def check(url: str, **names: list[str]) -> str:
    return asyncio.run(resolver(**names)[0].check(url)).pinned_url


def test_what_is_connected_to_is_what_was_checked() -> None:
    # a name that turns to loopback after its first answer: the second one is never asked for
    assert check("https://tree.example/a?b=c#d", tree=["93.184.216.34", "127.0.0.1"]) == "https://93.184.216.34/a?b=c"
    assert check("https://tree.example:443/", tree=["2606:2800:220:1::1"]) == "https://[2606:2800:220:1::1]:443/"


@pytest.mark.parametrize(
    "url",
    [
        *("http://tree.example/", "https://tree.example:8443/", "ftp://tree.example/", "file:///etc/passwd"),
        *("https://user:secret@tree.example/", "https:///nothing", "https://tree.example:99999/"),
        *(f"https://tree.example/{path}" for path in ("\u00fc", " b", "\x7f", "x" * 3000)),
        *("https://127.0.0.1/", "https://[::1]/", "https://169.254.169.254/latest/", "https://inside.example/"),
    ],
)
def test_a_url_that_leads_elsewhere_is_refused(url: str) -> None:
    with pytest.raises(OutboundError):
        check(url, tree=["93.184.216.34"], inside=["10.1.2.3"])


def test_a_name_of_no_address_or_a_private_one_is_refused() -> None:
    async def fails(host: str, port: int) -> list[str]:
        raise socket.gaierror

    async def none(host: str, port: int) -> list[str]:
        return []

    async def one_private_among_public(host: str, port: int) -> list[str]:
        return ["93.184.216.34", "127.0.0.1"]

    for look_up in (fails, none, one_private_among_public):
        with pytest.raises(OutboundError):
            asyncio.run(Outbound(look_up=look_up).check("https://tree.example/"))


def answer(_: int, handler: Handler) -> None:
    """Redirects, a file, and a server that breaks off."""
    if handler.path.startswith("/to/"):
        handler.reply(302, b"", Location=handler.path.removeprefix("/to/"))
    elif handler.path == "/short":
        handler.break_off(b"half", 100)
    else:
        handler.reply(200 if handler.path == "/file" else 404, b"tree")


@pytest.fixture(scope="module")
def line() -> Iterator[Line]:
    with answering(answer) as opened:
        yield opened


async def fetched(line: Line, path: str) -> bytes:
    site = line.url.replace("http://127.0.0.1", "tree.example")

    async def look_up(host: str, port: int) -> list[str]:
        return ["127.0.0.1" if host == "tree.example" else "10.0.0.1"]

    async with Outbound(private_hosts=(site,), look_up=look_up).get(f"http://{site}{path}") as response:
        return b"".join([chunk async for chunk in response.aiter_raw()])


def test_a_file_is_fetched_by_its_name_from_the_checked_address(line: Line) -> None:
    assert asyncio.run(fetched(line, "/file")) == b"tree"
    assert line.requests[-1].headers["host"].startswith("tree.example:")
    assert asyncio.run(fetched(line, "/to//file")) == b"tree"


@pytest.mark.parametrize(
    "path",
    [
        *("/to/http://inside.example/file", "/to/https://inside.example/", "/to/file:///etc/passwd"),
        *("/to//to//to//to//to//file", "/absent", "/short"),
    ],
)
def test_a_redirect_is_checked_as_the_first_address_was(line: Line, path: str) -> None:
    with pytest.raises(OutboundError):
        asyncio.run(fetched(line, path))


def test_who_does_not_answer_is_reported() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        closed = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(OutboundError, match="does not answer"):
            asyncio.run(_open(closed))


async def _open(where: str) -> None:
    async with Outbound(private_hosts=(where,)).get(f"http://{where}/"):
        pass
