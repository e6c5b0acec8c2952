"""A moving tree as one HTML file that plays from disk: it contains the viewer, its libraries and the tree."""

import base64
import gzip
import io
import re
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import PurePosixPath
from typing import BinaryIO

from dynamictree.errors import InputError
from dynamictree.formats.tensors.animated_splat import write_animated_splat
from dynamictree.gaussian.animate import AnimatedSplat
from web.vendor import FOLDER, LIBRARIES

MAX_SPLAT_BYTES = 256 * 1024**2
"""Largest splat inside a page: its base64 text must stay below the longest that browsers allow, 512 MiB."""
_THREE, _SPARK, _FFLATE = (
    next(one for one in LIBRARIES if one.name == name) for name in ("three", "@sparkjsdev/spark", "fflate")
)
_CORE = {
    "three-core": f"vendor/{_THREE.target('three.core.js')}",
    "three": f"vendor/{_THREE.target('three.module.js')}",
    "orbit-controls": f"vendor/{_THREE.target('addons/controls/OrbitControls.js')}",
}
_MESH = {
    "buffer-geometry-utils": f"vendor/{_THREE.target('addons/utils/BufferGeometryUtils.js')}",
    "skeleton-utils": f"vendor/{_THREE.target('addons/utils/SkeletonUtils.js')}",
    "gltf-loader": f"vendor/{_THREE.target('addons/loaders/GLTFLoader.js')}",
}
_SPLAT = {
    "three/addons/postprocessing/Pass.js": f"vendor/{_THREE.target('addons/postprocessing/Pass.js')}",
    "@sparkjsdev/spark": f"vendor/{_SPARK.target('spark.module.min.js')}",
    "tensors": "motion/tensors.js",
    "vectors": "motion/vectors.js",
    "modes": "motion/modes.js",
    "flutter": "motion/flutter.js",
    "swing": "motion/swing.js",
    "pass": "draw/pass.js",
    "bands": "motion/bands.js",
    "gust": "draw/gust.js",
    "field": "draw/field.js",
    "splat-shader": "draw/splat_shader.js",
    "splat": "draw/splat.js",
}
_LICENCES = {
    "three.js": _THREE.target("LICENSE"),
    "Spark": _SPARK.target("LICENSE"),
    "fflate": _FFLATE.target("LICENSE"),
}
_PLAYERS = {"player_mesh.js": (_CORE | _MESH, ("three.js",)), "player_splat.js": (_CORE | _SPLAT, tuple(_LICENCES))}
"""By a page's script: its modules, from name in the import map to path in `web/`, and the licences to include."""
_IMPORT = re.compile(r"""(from\s*|import\s*)(["'])(\.{1,2}/[^"']*)\2""")


def write_html(glb: bytes, stream: BinaryIO, *, title: str) -> None:
    """Write a page that shows the first animation of a GLB, with a camera that the user moves."""
    _write_page("player_mesh.js", glb, stream, title)


def write_splat_html(splat: AnimatedSplat, stream: BinaryIO, *, title: str) -> None:
    """Write a page that plays the loop of a splat, with a camera that the user moves.

    Raises:
        InputError: the splat is too large for a page.
        NumericsError: a value is larger than a half float can hold.
    """
    content = io.BytesIO()
    write_animated_splat(splat, content)
    size = content.tell()
    if size > MAX_SPLAT_BYTES:
        raise InputError(
            f"{splat.binding.cloud.num_gaussians:,} Gaussians as html-splat are {size / 1e6:.0f} MB, above "
            f"{MAX_SPLAT_BYTES / 1e6:.0f} MB: ask for a lower share or sh_degree, or for the format splat"
        )
    _write_page("player_splat.js", content.getvalue(), stream, title)


def _write_page(player: str, tree: bytes, stream: BinaryIO, title: str) -> None:
    head, middle, tail = re.split("TITLE|PARTS", _beside("player.html"))
    for piece in (head, escape(title), middle, _viewer(player), _part('id="tree"', tree), tail):
        stream.write(piece.encode())


@cache
def _viewer(player: str) -> str:
    """Return the licences and modules of a page; its script `player` is beside this module."""
    modules, licences = _PLAYERS[player]
    texts = [f"<!-- {name}:\n{_of_web(f'vendor/{_LICENCES[name]}').strip()}\n-->\n" for name in licences]
    names = {PurePosixPath(place).name: name for name, place in modules.items()}
    sources = {name: _with_names(_of_web(place), names) for name, place in modules.items()}
    parts = [
        _part(f'data-module="{name}"', source.encode())
        for name, source in (sources | {"scene": _beside(player)}).items()
    ]
    return "".join([*texts, *parts])


def _with_names(source: str, names: dict[str, str]) -> str:
    """Replace a module's relative imports by the names in the page's import map."""
    return _IMPORT.sub(lambda match: f'{match[1]}"{names[PurePosixPath(match[3]).name]}"', source)


def _of_web(place: str) -> str:
    return (FOLDER.parent / place).read_text(encoding="utf-8")


def _beside(name: str) -> str:
    return (files(__package__) / name).read_text(encoding="utf-8")


def _part(attribute: str, content: bytes) -> str:
    packed = base64.b64encode(gzip.compress(content, mtime=0)).decode()
    return f'<script type="text/plain" {attribute}>{packed}</script>\n'
