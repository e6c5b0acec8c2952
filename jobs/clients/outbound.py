"""Requests to addresses that clients name: resolve the name once, check the address, and connect to that address."""

import asyncio
import ipaddress
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from urllib.parse import SplitResult, urljoin, urlsplit

from jobs.errors import OutboundError

if TYPE_CHECKING:
    import httpx

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Lookup = Callable[[str, int], Awaitable[list[str]]]

CONNECT_S = 10.0
READ_S = 30.0
MAX_REDIRECTS = 3
MAX_URL_CHARS = 2048
_EMBEDS_V4 = (  # IPv6 networks that embed an IPv4 address, and the shift of that address [bits]
    (ipaddress.ip_network("::ffff:0:0/96"), 0),  # IPv4-mapped
    (ipaddress.ip_network("::ffff:0:0:0/96"), 0),  # IPv4-translated, RFC 7915
    (ipaddress.ip_network("64:ff9b::/96"), 0),  # NAT64
    (ipaddress.ip_network("2002::/16"), 80),  # 6to4
)
_ISATAP = (0x0000_5EFE, 0x0200_5EFE)  # beginnings of the second half of an ISATAP address; an IPv4 address follows
_GLOBAL_V6 = ipaddress.ip_network("2000::/3")  # all global addresses that IANA has assigned
_SPECIAL = tuple(  # IANA's registries of special addresses; those in the standard library depend on its version
    ipaddress.ip_network(text)
    for text in (
        *("0.0.0.0/8", "10.0.0.0/8", "100.64.0.0/10", "127.0.0.0/8", "169.254.0.0/16", "172.16.0.0/12"),
        *("192.0.0.0/24", "192.0.2.0/24", "192.88.99.0/24", "192.168.0.0/16", "198.18.0.0/15", "198.51.100.0/24"),
        *("203.0.113.0/24", "224.0.0.0/3"),
        *("2001::/23", "2001:db8::/32", "3fff::/20"),
        "168.63.129.16/32",  # a public number, but a service within Azure
    )
)


async def look_up(host: str, port: int) -> list[str]:
    """Resolve a name with the system's resolver."""
    results = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return [str(entry[4][0]) for entry in results]


def is_public(address: Address) -> bool:
    """Return whether an address is globally reachable, and an IPv4 address embedded in it too."""
    if isinstance(address, ipaddress.IPv6Address):
        for network, shift in _EMBEDS_V4:
            if address in network:
                return is_public(ipaddress.IPv4Address((int(address) >> shift) & 0xFFFF_FFFF))
        if address not in _GLOBAL_V6:
            return False
        if (int(address) >> 32) & 0xFFFF_FFFF in _ISATAP:
            return is_public(ipaddress.IPv4Address(int(address) & 0xFFFF_FFFF))
    return not any(address in network for network in _SPECIAL)


@dataclass(frozen=True, kw_only=True)
class Target:
    """Target of a request: a URL and its checked address."""

    url: str
    parts: SplitResult
    address: str

    @property
    def pinned_url(self) -> str:
        """Return the URL with the checked address in place of the host name."""
        host_part = f"[{self.address}]" if ":" in self.address else self.address
        port = f":{self.parts.port}" if self.parts.port is not None else ""
        return self.parts._replace(netloc=host_part + port, fragment="").geturl()


@dataclass(frozen=True, kw_only=True)
class Outbound:
    """Client for outbound requests. `private_hosts` (host or host:port) may be private and use plain HTTP."""

    private_hosts: tuple[str, ...] = ()
    look_up: Lookup = field(default=look_up)

    async def check(self, url: str) -> Target:
        """Resolve a URL's host and check its address.

        Raises:
            OutboundError: the URL is not allowed, or its host has a private address.
        """
        parts = self.check_form(url)
        host, port = parts.hostname or "", parts.port or (443 if parts.scheme == "https" else 80)
        try:
            results = await asyncio.wait_for(self.look_up(host, port), CONNECT_S)
        except (OSError, UnicodeError, TimeoutError) as error:
            raise OutboundError(f"the name {host!r} cannot be looked up") from error
        addresses = [ipaddress.ip_address(text.partition("%")[0]) for text in results]
        if not addresses:
            raise OutboundError(f"the name {host!r} has no address")
        if not self._private_allowed(parts) and not all(map(is_public, addresses)):
            raise OutboundError(f"{host!r} leads to an address that is not public; see the setting outbound_hosts")
        return Target(url=url, parts=parts, address=str(addresses[0]))

    def check_form(self, url: str) -> SplitResult:
        """Check the form of a URL without resolving its host.

        Raises:
            OutboundError: the URL is not allowed.
        """
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise OutboundError(f"the URL cannot be read: {error}") from error
        if len(url) > MAX_URL_CHARS or not url.isascii() or not url.isprintable() or " " in url:
            raise OutboundError(f"a URL has at most {MAX_URL_CHARS} printable ASCII characters; encode the others")
        if not parts.hostname or parts.username is not None or parts.password is not None:
            raise OutboundError("the URL needs a host, and must not carry a user or password")
        if self._private_allowed(parts) and parts.scheme in {"http", "https"}:
            return parts
        if parts.scheme != "https" or port not in {None, 443}:
            raise OutboundError(f"only https on port 443 is allowed, found {parts.scheme}, port {port or 'default'}")
        return parts

    def _private_allowed(self, parts: SplitResult) -> bool:
        return parts.hostname in self.private_hosts or f"{parts.hostname}:{parts.port}" in self.private_hosts

    @asynccontextmanager
    async def send(
        self, target: Target, method: str, *, headers: Mapping[str, str], content: bytes | None = None
    ) -> "AsyncIterator[httpx.Response]":
        """Make one request to the checked address, without following redirects; the caller reads the body.

        Raises:
            OutboundError: the server did not respond.
        """
        import httpx

        timeout = httpx.Timeout(READ_S, connect=CONNECT_S)
        # no proxy or credentials of this machine; the certificate must match the host name, not the address
        async with httpx.AsyncClient(timeout=timeout, trust_env=False, follow_redirects=False) as client:
            try:
                request = client.build_request(
                    method,
                    target.pinned_url,
                    headers={"Accept-Encoding": "identity", **headers, "Host": target.parts.netloc},
                    content=content,
                    extensions={"sni_hostname": target.parts.hostname},
                )
                response = await client.send(request, stream=True)
            except (httpx.HTTPError, httpx.InvalidURL) as error:
                raise OutboundError(f"{target.parts.hostname} does not answer: {_message_of(error)}") from error
            try:
                yield response
            except httpx.HTTPError as error:
                raise OutboundError(f"{target.parts.hostname} broke off: {_message_of(error)}") from error
            finally:
                await response.aclose()

    @asynccontextmanager
    async def get(self, url: str) -> "AsyncIterator[httpx.Response]":
        """GET a URL, following at most `MAX_REDIRECTS` redirects, each checked like the first URL.

        Raises:
            OutboundError: the URL is not allowed, or the response is no file.
        """
        for _ in range(MAX_REDIRECTS + 1):
            target = await self.check(url)
            async with self.send(target, "GET", headers={"Accept": "*/*"}) as response:
                if response.is_redirect:
                    url = urljoin(url, response.headers.get("location", ""))
                    continue
                if response.status_code != 200:
                    raise OutboundError(f"{target.parts.hostname} answered {response.status_code}; 200 is needed")
                yield response
                return
        raise OutboundError(f"there were more than {MAX_REDIRECTS} redirects; give the last address itself")


def _message_of(error: Exception) -> str:
    return str(error) or type(error).__name__
