"""Textures of a GLB as WebP (EXT_texture_webp), each only if that is smaller.

Colours are lossy (libwebp's quality 90; transparency and colours under it are exact). All else, such as normals and
roughness, is lossless: lossy WebP halves the resolution of chroma, which stores directions there.
"""

import io
from collections.abc import Iterator
from typing import Any

from dynamictree.errors import FormatError
from dynamictree.formats.texture import decoded_image

WEBP = "EXT_texture_webp"
_COLORS = frozenset(
    {"baseColorTexture", "emissiveTexture", "diffuseTexture", "specularColorTexture", "sheenColorTexture"}
)
_FORMATS = ("PNG", "JPEG")  # formats of glTF without extensions


def webp_textures(root: dict[str, Any], contents: list[bytes]) -> None:
    """Replace a document's images by smaller WebP ones, and declare the extension if there are any.

    Images that are damaged, too large, or shared with another extension stay.
    """
    uses = dict[int, set[str]]()
    for name, entry in named_textures(root.get("materials", [])):
        uses.setdefault(entry["index"], set()).add(name)
    changed = False
    for index, textures in _replaceable_images(root).items():
        names = set[str]().union(*(uses.get(texture, set()) for texture in textures))
        packed = _encoded(contents[index], lossless=not names or bool(names - _COLORS))
        if packed is None or len(packed) >= len(contents[index]):
            continue
        contents[index], changed = packed, True
        root["images"][index]["mimeType"] = "image/webp"
        for texture in textures:
            entry = root["textures"][texture]
            entry["extensions"] = {**entry.get("extensions", {}), WEBP: {"source": entry.pop("source")}}
    for listed in ("extensionsUsed", "extensionsRequired") if changed else ():
        root[listed] = [*(name for name in root.get(listed, []) if name != WEBP), WEBP]


def named_textures(entry: object) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the references to textures in materials, with the name of each."""
    below = entry.items() if isinstance(entry, dict) else enumerate(entry) if isinstance(entry, list) else ()
    for name, one in below:
        if str(name).endswith("Texture") and isinstance(one, dict):
            yield str(name), one
        yield from named_textures(one)


def _replaceable_images(root: dict[str, Any]) -> dict[int, list[int]]:
    """Return the textures of each image that is used only by textures without extensions."""
    textures: dict[int, list[int]] = {}
    other = set[int]()
    for number, texture in enumerate(root.get("textures", [])):
        if texture.get("extensions"):
            other |= {one["source"] for one in (texture, *texture["extensions"].values()) if "source" in one}
        elif "source" in texture:
            textures.setdefault(texture["source"], []).append(number)
    return {index: numbers for index, numbers in textures.items() if index not in other}


def _encoded(content: bytes, *, lossless: bool) -> bytes | None:
    """Encode an image as WebP; None if it cannot be decoded or is too large."""
    quality = 90
    max_side_px = 16_383  # limit of the format
    try:
        image = decoded_image(content, "image", formats=_FORMATS)
    except FormatError:
        return None
    if image.mode not in ("RGB", "RGBA", "L", "LA", "P") or max(image.size) > max_side_px:
        return None
    seen = image.convert("RGBA" if image.has_transparency_data else "RGB")
    stream = io.BytesIO()
    seen.save(stream, "WEBP", lossless=lossless, quality=75 if lossless else quality, alpha_quality=100, exact=True)
    return stream.getvalue()
