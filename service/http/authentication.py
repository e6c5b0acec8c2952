"""Check API keys if they are required; otherwise accept only requests of this machine, not of other sites' pages."""

import ipaddress
import logging
from dataclasses import replace
from urllib.parse import urlsplit

import sqlalchemy as sa
from cachetools import TTLCache
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from jobs.clients.keys import digest_of, find_key, record_use
from jobs.records import KeyRecord
from jobs.records import Scope as KeyScope
from jobs.settings import Settings
from jobs.store import Store
from service.http.caller import ANYONE, CALLER, Caller, caller_of
from service.http.problems import ADDED_HEADERS, ProblemError
from service.http.rate_limit import Allowance, RateLimiter, limit_of
from service.http.signed_links import LINKABLE, LinkSignature

logger = logging.getLogger(__name__)

CACHE_S = 2.0
"""Lifetime of a cached key [s]; a revoked key is accepted for at most this long."""

MAX_CACHED = 10_000
FORWARDED = ("forwarded", "x-forwarded-", "x-real-ip", "via", "cf-connecting-ip", "true-client-ip", "x-client-ip")
"""Prefixes of headers that proxies add. Behind a local proxy, every request seems to come from this machine."""

LINK_HEADERS = {"Access-Control-Allow-Origin": "*", "Cross-Origin-Resource-Policy": "cross-origin"}
"""Headers of responses to signed links. The link is the permission, so a page of any site may show the file."""

POLICY_VIOLATION = 1008
PROTOCOL_KEY = "bearer."


class Authentication:
    """Middleware for /v1: authentication, scopes and rate limits."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app = app
        self.settings = settings
        self._limiter = RateLimiter(settings.resolved_redis_url) if settings.keys == "required" else None
        self._keys: TTLCache[str, KeyRecord | None] = TTLCache(MAX_CACHED, CACHE_S)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Accept or refuse one request."""
        if scope["type"] not in {"http", "websocket"} or not scope["path"].startswith("/v1/"):
            await self.app(scope, receive, send)
            return
        standing: Allowance | None = None
        try:
            caller = await self._caller(scope)
            if self._limiter is not None:
                standing = await self._limiter.count(caller, limit_of(scope.get("method", "GET"), scope["path"]))
            if standing is not None and not standing.allowed:
                allowance = f"{standing.quota} {standing.name} in {standing.window_s} s are allowed"
                raise ProblemError("rate-limited", f"{allowance}; wait {standing.reset_s} s", headers=standing.headers)
        except sa.exc.OperationalError:
            logger.warning("the database is away", exc_info=True)
            away = ProblemError("storage-unavailable", "the database does not answer; the key cannot be checked")
            await _refuse(away, scope, receive, send)
            return
        except ProblemError as error:
            if error.code == "unauthorized" and self._limiter is not None:
                wrong = await self._limiter.count_wrong_key((scope.get("client") or ("",))[0])
                if not wrong.allowed:
                    detail = f"{wrong.quota} requests with a wrong key in {wrong.window_s} s are allowed"
                    error = ProblemError("rate-limited", detail, headers=wrong.headers)
            await _refuse(error, scope, receive, send)
            return
        scope[CALLER] = caller
        scope[ADDED_HEADERS] = ({} if standing is None else standing.headers) | (LINK_HEADERS if caller.by_link else {})
        await self.app(scope, receive, send)

    async def _caller(self, scope: Scope) -> Caller:
        headers = Headers(scope=scope)
        settings = self.settings
        if scope.get("method") == "OPTIONS" or settings.keys == "none":
            return ANYONE
        if settings.keys == "loopback":
            require_own_machine(scope, headers, settings.hosts, settings.cors_origins)
            return ANYONE
        store: Store = scope["app"].state.services.store
        link = LinkSignature.of_query(scope.get("query_string", b""))
        if link is not None and "authorization" not in headers:
            return await self._linked(link, scope, store)
        key = await self._key(_bearer(headers), store)
        wanted = _scope_of(scope)
        if wanted not in key.scopes:
            detail = f"this key may {', '.join(key.scopes)}; {wanted} is needed here"
            raise ProblemError("forbidden", detail)
        return caller_of(key, settings)

    async def _linked(self, link: LinkSignature, scope: Scope, store: Store) -> Caller:
        """Return the caller who signed a link."""
        cached = f"id:{link.key_id}"
        try:
            key = self._keys[cached]
        except KeyError:
            key = self._keys[cached] = await run_in_threadpool(find_key, store, id=link.key_id)
        right = key is not None and key.valid(store.clock()) and "read" in key.scopes
        reads = scope["type"] == "http" and scope["method"] in {"GET", "HEAD"}
        path = scope["path"]
        if key is None or not (right and reads and LINKABLE.fullmatch(path) and link.opens(key, path, store.clock())):
            raise _unauthorized("the link has expired, its key was revoked, or it is for another address")
        return replace(caller_of(key, self.settings), scopes=("read",), by_link=True)

    async def _key(self, key: str, store: Store) -> KeyRecord:
        digest, fresh = digest_of(key), False
        try:
            record = self._keys[digest]
        except KeyError:
            record = self._keys[digest] = await run_in_threadpool(find_key, store, digest=digest)
            fresh = True
        if record is None or not record.valid(store.clock()):
            raise _unauthorized("the key is unknown, revoked or has expired")
        if fresh:
            await run_in_threadpool(record_use, store, record)
        return record


def require_own_machine(scope: Scope, headers: Headers, hosts: tuple[str, ...], cors_origins: tuple[str, ...]) -> None:
    """Refuse requests through a proxy, to an address beyond loopback, to an unknown Host, or from another site."""
    server = scope.get("server")
    arrived = _address(server[0]) if server else None
    if arrived is not None and not arrived.is_loopback:
        detail = f"the request came to {arrived}, and no key is required; set DYNAMICTREE_KEYS=required"
        raise ProblemError("forbidden", f"{detail}, and make one with `dynamictree keys create`")
    if through := next((name for name in headers if name.startswith(FORWARDED)), None):
        detail = f"the request came through a proxy ({through}), and no key is required"
        raise ProblemError("forbidden", f"{detail}; set DYNAMICTREE_KEYS=required")
    name = urlsplit("//" + headers.get("host", "")).hostname or ""
    address = _address(name)
    if not (name in {"", "localhost", *hosts} or name.endswith(".localhost") or address is not None):
        raise ProblemError("forbidden", f"the Host is {name!r}; this service answers as localhost, see `hosts`")
    origin = headers.get("origin")
    own = {f"{scheme}://{headers.get('host', '')}" for scheme in ("http", "https")}
    if origin is not None and origin not in own and origin not in cors_origins:
        raise ProblemError("forbidden", f"a page of {origin} may not call this service; see `cors_origins`")


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


def _bearer(headers: Headers) -> str:
    kind, _, key = headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer" and key.strip():
        return key.strip()
    # a page cannot set headers of a WebSocket, only its protocols
    for protocol in headers.get("sec-websocket-protocol", "").split(","):
        if protocol.strip().startswith(PROTOCOL_KEY):
            return protocol.strip().removeprefix(PROTOCOL_KEY)
    raise _unauthorized("a key is required; send it as Authorization: Bearer KEY")


def _scope_of(scope: Scope) -> KeyScope:
    if scope["path"].startswith("/v1/interact"):
        return "interact"
    if scope["path"] == "/v1/links":
        return "read"
    return "read" if scope.get("method", "GET") in {"GET", "HEAD"} else "write"


def _unauthorized(detail: str) -> ProblemError:
    return ProblemError("unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})


async def _refuse(error: ProblemError, scope: Scope, receive: Receive, send: Send) -> None:
    logger.info("refused: %s", error.code, extra={"path": scope["path"]})
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": POLICY_VIOLATION, "reason": error.code})
        return
    await error.response(scope)(scope, receive, send)
