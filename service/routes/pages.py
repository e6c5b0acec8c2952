"""`/`, `/docs` and `/web/…`: the viewer, the page of the API and their files. They are the same for everyone."""

import base64
import gzip
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

from fastapi import APIRouter, Request, Response
from starlette.concurrency import run_in_threadpool

from service.http.problems import ProblemError
from service.http.request_headers import SAFETENSORS, matches

router = APIRouter(include_in_schema=False)

MEDIA_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "txt": "text/plain; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
    "webp": "image/webp",
    "glb": "model/gltf-binary",
    "safetensors": SAFETENSORS,
    "wasm": "application/wasm",
}
LEVEL = 6
"""Level of gzip; each page is compressed once per start."""

VENDORED = "public, max-age=31536000, immutable"
"""Cache-Control of vendored libraries: their paths hold the version."""

ELEMENT = "embed/dynamic-tree.js"
ANY_SITE = {"Access-Control-Allow-Origin": "*", "Cross-Origin-Resource-Policy": "cross-origin"}
"""Headers of the element's script: browsers load module scripts of another site with CORS."""

_IMPORT_MAP = re.compile(r'<script type="importmap">(.*?)</script>', re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class Page:
    """Content and headers of one file."""

    media_type: str
    content: bytes
    packed: bytes  # gzip of the content; the content itself if gzip is no smaller
    etag: str  # changes with the content


def answer(request: Request, page: Page, headers: dict[str, str]) -> Response:
    """Return the page, compressed if the browser accepts gzip; 304 if the browser has it already."""
    headers = {"ETag": page.etag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"} | headers
    if matches(request.headers.get("if-none-match"), page.etag):
        return Response(None, 304, headers)
    if page.packed is page.content or "gzip" not in request.headers.get("accept-encoding", ""):
        return Response(page.content, 200, headers, page.media_type)
    return Response(page.packed, 200, headers | {"Content-Encoding": "gzip"}, page.media_type)


# These routes run in the event loop and read headers themselves: a visit makes 70 requests, and threads and injected
# headers would double the cost of each.


@router.api_route("/", methods=["GET", "HEAD"])
async def get_viewer(request: Request) -> Response:
    """The viewer."""
    page = await read_page("index.html")
    return answer(request, page, viewer_policy(page.content))


@router.api_route("/embed", methods=["GET", "HEAD"])
async def get_embed_page(request: Request) -> Response:
    """One tree, for a frame in the pages of `embed_origins`."""
    page = await read_page("embed.html")
    ancestors = " ".join(("'self'", *request.app.state.services.settings.embed_origins))
    return answer(request, page, viewer_policy(page.content, ancestors=ancestors))


@router.api_route("/docs", methods=["GET", "HEAD"])
async def get_api_page(request: Request) -> Response:
    """Every operation of the API, to read and to try."""
    icons = {"img-src": "'self' data: blob:"}  # Swagger UI embeds icons in its style sheet
    return answer(request, await read_page("docs.html"), content_policy(icons))


@router.api_route("/llms.txt", methods=["GET", "HEAD"])
async def get_llms_text(request: Request) -> Response:
    """How to use the service, for language models (llmstxt.org)."""
    return answer(request, await read_page("llms.txt"), {})


@router.api_route("/web/{path:path}", methods=["GET", "HEAD"])
async def get_page_file(path: str, request: Request) -> Response:
    """Files of the viewer."""
    headers = {"Cache-Control": VENDORED} if path.startswith("vendor/") else {}
    if path == ELEMENT:
        headers |= ANY_SITE
    return answer(request, await read_page(path), headers)


def content_policy(allowed: Mapping[str, str]) -> dict[str, str]:
    """Return a CSP header that allows a page its own scripts, styles and service, and the sources in `allowed`."""
    policy = {"default-src": "'none'"} | dict.fromkeys(("script-src", "style-src", "connect-src"), "'self'")
    policy |= dict.fromkeys(("base-uri", "form-action", "frame-ancestors"), "'none'") | dict(allowed)
    return {"Content-Security-Policy": "; ".join(f"{name} {where}" for name, where in policy.items())}


def viewer_policy(page: bytes, *, ancestors: str = "'none'") -> dict[str, str]:
    """Return the viewer's CSP: it also loads blobs for textures, and Spark's sorting worker, which is WebAssembly.

    Browsers accept an import map only inline, so the policy holds its hash.
    """
    [import_map] = _IMPORT_MAP.findall(page.decode())
    digest = base64.b64encode(hashlib.sha256(import_map.encode()).digest()).decode()
    allowed = {
        "script-src": f"'self' 'wasm-unsafe-eval' 'sha256-{digest}'",
        "img-src": "'self' blob: data:",
        "connect-src": "'self' blob: data:",
        "worker-src": "'self' blob:",
        "frame-ancestors": ancestors,
    }
    return content_policy(allowed)


packed_pages: dict[str, Page] = {}
"""Requested pages by package and path; paths that do not exist are not cached."""


async def read_page(path: str, package: str = "web") -> Page:
    """Return a file of a package, read and compressed at its first request."""
    name = f"{package}/{path}"
    if name not in packed_pages:
        packed_pages[name] = await run_in_threadpool(_pack_page, path, package)
    return packed_pages[name]


def _pack_page(path: str, package: str) -> Page:
    valid = re.fullmatch(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*(/[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*)*", path)
    media_type = MEDIA_TYPES.get(path.rpartition(".")[2])
    file = resources.files(package).joinpath(path if valid else "")
    if media_type is None or not file.is_file():
        raise ProblemError("not-found", f"the viewer has no file {path[:128]!r}")
    content = file.read_bytes()
    packed = gzip.compress(content, LEVEL, mtime=0)
    etag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    return Page(media_type=media_type, content=content, packed=min(content, packed, key=len), etag=etag)
