"""Textures of a GLB as WebP (EXT_texture_webp), each only where that is smaller.

Colours are rounded (libwebp's quality 90, transparency and what lies under it exact). All else, such as normals and
roughness, is stored without loss: WebP halves the resolution of colour differences, which hold directions there.
"""

import io
from collections.abc import Iterator
from typing import Any

from dynamictree.errors import FormatError
from dynamictree.formats.gltf.writer import GlbWriter
from dynamictree.formats.texture import decoded_image

WEBP = "EXT_texture_webp"
_COLORS = frozenset(
    {"baseColorTexture", "emissiveTexture", "diffuseTexture", "specularColorTexture", "sheenColorTexture"}
)
_FORMATS = ("PNG", "JPEG")  # what glTF has without an extension


def webp_textures(writer: GlbWriter) -> None:
    """Replace images of a document under construction by smaller ones, and name the extension where there are any.

    What is damaged, too large, or has another extension's image beside it stays.
    """
    root, content = writer.root, b"".join(writer.chunks)
    views: list[dict[str, Any]] = root.get("bufferViews", [])
    smaller: dict[int, bytes] = {}  # by view
    for index, textures in _plain_images(root).items():
        image = root["images"][index]
        number = image.get("bufferView")
        if number is None:
            continue
        start, length = views[number].get("byteOffset", 0), views[number]["byteLength"]
        names = {name for texture in textures for name in _uses(root.get("materials", []), texture)}
        packed = _encoded(content[start : start + length], lossless=not names or bool(names - _COLORS))
        if packed is None or len(packed) >= length:
            continue
        smaller[number] = packed
        image["mimeType"] = "image/webp"
        for texture in textures:
            entry = root["textures"][texture]
            entry["extensions"] = {**entry.get("extensions", {}), WEBP: {"source": entry.pop("source")}}
    if not smaller:
        return
    _replace(writer, content, smaller)
    for listed in ("extensionsUsed", "extensionsRequired"):
        root[listed] = [*(name for name in root.get(listed, []) if name != WEBP), WEBP]


def _plain_images(root: dict[str, Any]) -> dict[int, list[int]]:
    """Textures of each image that nothing but textures without extensions uses, and whose bytes it has for itself."""
    textures: dict[int, list[int]] = {}
    other = set[int]()
    for number, texture in enumerate(root.get("textures", [])):
        if texture.get("extensions"):
            other |= {value for entry in texture["extensions"].values() for value in _sources(entry)}
            other |= _sources(texture)
        elif "source" in texture:
            textures.setdefault(texture["source"], []).append(number)
    taken = [image.get("bufferView") for image in root.get("images", [])]
    taken += [accessor.get("bufferView") for accessor in root.get("accessors", [])]
    return {
        index: numbers
        for index, numbers in textures.items()
        if index not in other and taken.count(root["images"][index].get("bufferView")) == 1
    }


def _sources(entry: object) -> set[int]:
    return {entry["source"]} if isinstance(entry, dict) and isinstance(entry.get("source"), int) else set()


def _uses(entry: object, texture: int) -> Iterator[str]:
    """Names under which materials refer to a texture."""
    entries = entry.items() if isinstance(entry, dict) else enumerate(entry) if isinstance(entry, list) else ()
    for name, below in entries:
        if isinstance(below, dict) and str(name).endswith("Texture") and below.get("index") == texture:
            yield str(name)
        yield from _uses(below, texture)


def _encoded(content: bytes, *, lossless: bool) -> bytes | None:
    """The picture as WebP; None if it cannot be decoded, or is too large."""
    quality = 90
    max_side_px = 16_383  # of the format
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


def _replace(writer: GlbWriter, content: bytes, smaller: dict[int, bytes]) -> None:
    """Write the views anew, those of the same bytes once."""
    places: dict[tuple[int, int], int] = {}
    writer.chunks, writer.num_bytes = [], 0
    for number, view in enumerate(writer.root["bufferViews"]):
        start, length = view.get("byteOffset", 0), view["byteLength"]
        own = smaller.get(number)
        if own is None and (start, length) in places:
            view["byteOffset"] = places[start, length]
            continue
        part = content[start : start + length] if own is None else own
        view |= {"byteOffset": writer.add_bytes(part), "byteLength": len(part)}
        if own is None:
            places[start, length] = view["byteOffset"]
