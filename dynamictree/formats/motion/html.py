"""An animated mesh as one HTML file that plays from disk: three.js, its loader and the GLB, all inside."""

import base64
import gzip
import re
from html import escape
from importlib.resources import files
from typing import BinaryIO

from web.vendor import FOLDER, LIBRARIES

_MODULES = {
    "three-core": "three.core.js",
    "three": "three.module.js",
    "buffer-geometry-utils": "addons/utils/BufferGeometryUtils.js",
    "skeleton-utils": "addons/utils/SkeletonUtils.js",
    "gltf-loader": "addons/loaders/GLTFLoader.js",
    "orbit-controls": "addons/controls/OrbitControls.js",
}
_THREE = next(library for library in LIBRARIES if library.name == "three")
_IMPORT = re.compile(r"""(from\s*|import\s*)(["'])(\.{1,2}/[^"']*)\2""")


def write_html(glb: bytes, stream: BinaryIO, *, title: str) -> None:
    """Write a page that shows the first animation of a GLB, with a camera that the reader moves."""
    parts = [_part(f"module-{name}", _module(path), f' data-module="{name}"') for name, path in _MODULES.items()]
    parts.append(_part("tree", glb))
    licence = _vendored("LICENSE").strip()
    page = (files(__package__) / "player.html").read_text(encoding="utf-8")
    page = page.replace("TITLE", escape(title)).replace("PARTS", f"<!-- three.js:\n{licence}\n-->\n" + "\n".join(parts))
    stream.write(page.encode())


def _module(path: str) -> bytes:
    """A module whose imports of neighbours name them as the page's import map does."""
    names = {place.rpartition("/")[2]: name for name, place in _MODULES.items()}
    own = _IMPORT.sub(lambda match: f'{match[1]}"{names[match[3].rpartition("/")[2]]}"', _vendored(path))
    return own.encode()


def _vendored(path: str) -> str:
    return (FOLDER / _THREE.target(path)).read_text(encoding="utf-8")


def _part(name: str, content: bytes, more: str = "") -> str:
    packed = base64.b64encode(gzip.compress(content, mtime=0)).decode()
    return f'<script type="text/plain" id="{name}"{more}>{packed}</script>'
