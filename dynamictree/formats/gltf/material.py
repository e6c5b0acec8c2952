"""Materials and texture coordinates of glTF, for the base colour alone."""

import io
import struct
from collections.abc import Mapping
from importlib.util import find_spec
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float32, Shaped
from PIL import Image

from dynamictree.errors import FormatError
from dynamictree.formats.companions import KTX2_MAGIC, find_companion
from dynamictree.formats.gltf.document import GltfDocument, uri_bytes
from dynamictree.formats.json_fields import (
    JsonObject,
    index_field,
    integer_field,
    number_field,
    numbers_field,
    object_field,
    object_list,
    text_field,
)
from dynamictree.formats.texture import MAX_PIXELS, refuse_many_pixels, texture_as_png
from dynamictree.mesh import Material, SourceWarning, refuse_many_materials


def gltf_materials(document: GltfDocument) -> tuple[Material, ...]:
    """Read the file's materials in order; each image is decoded once."""
    entries, images = object_list(document.root, "materials"), dict[int, bytes | None]()
    refuse_many_materials(len(entries))
    return tuple(_material(document, entry, images) for entry in entries)


def texture_coordinates(
    attributes: Mapping[str, Shaped[np.ndarray, "n width"]], material: JsonObject | None, count: int
) -> Float32[np.ndarray, "n 2"] | None:
    """Return the coordinates that the base colour's texture uses, with KHR_texture_transform applied."""
    texture = {} if material is None else _base_texture(material)
    transform = object_field(object_field(texture, "extensions"), "KHR_texture_transform")
    default_set = integer_field(texture, "texCoord", high=15, default=0)
    name = f"TEXCOORD_{integer_field(transform, 'texCoord', high=15, default=default_set)}"
    if name not in attributes:
        return None
    uv = attributes[name].astype(np.float32)
    if uv.shape != (count, 2):
        raise FormatError(f"{name} has shape {list(uv.shape)}; {[count, 2]} is needed")
    angle = number_field(transform, "rotation", 0.0)
    scale = np.array(numbers_field(transform, "scale", 2, (1.0, 1.0)))
    offset = np.array(numbers_field(transform, "offset", 2, (0.0, 0.0)))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moved = np.nan_to_num((uv * scale) @ turn.T + offset, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray(np.clip(moved, -1e6, 1e6), np.float32)


def texture_placement(material: JsonObject) -> str:
    """Return a key that is equal for materials with the same texture coordinates."""
    texture = _base_texture(material)
    return repr((texture.get("texCoord"), texture.get("extensions")))


def _base_texture(material: JsonObject) -> JsonObject:
    surface, _, texture = _surface(material)
    return object_field(surface, texture)


def _surface(material: JsonObject) -> tuple[JsonObject, str, str]:
    """Return the fields of a material's surface, and the names of its colour and its texture."""
    glossy = object_field(object_field(material, "extensions"), "KHR_materials_pbrSpecularGlossiness")  # Sketchfab's
    if glossy:
        return glossy, "diffuseFactor", "diffuseTexture"
    return object_field(material, "pbrMetallicRoughness"), "baseColorFactor", "baseColorTexture"


def _material(document: GltfDocument, entry: JsonObject, images: dict[int, bytes | None]) -> Material:
    blend_cutoff = 0.5  # our pictures cut out blended leaves; written files blend them
    surface, color, _ = _surface(entry)
    red, green, blue, alpha = (min(max(v, 0.0), 1.0) for v in numbers_field(surface, color, 4, (1.0,) * 4))
    mode = text_field(entry, "alphaMode", "OPAQUE")
    cutoffs = {"OPAQUE": None, "MASK": number_field(entry, "alphaCutoff", 0.5), "BLEND": blend_cutoff}
    if mode not in cutoffs:
        raise FormatError(f"alphaMode is {mode[:20]!r}; {', '.join(cutoffs)} are defined")
    return Material(
        name=text_field(entry, "name")[:200],
        base_color=(red, green, blue, alpha),
        texture_png=_texture(document, _base_texture(entry), images),
        alpha_cutoff=cutoffs[mode],
        double_sided=entry.get("doubleSided") is True,
        blended=mode == "BLEND",
    )


def _texture(document: GltfDocument, reference: JsonObject, images: dict[int, bytes | None]) -> bytes | None:
    textures, sources = object_list(document.root, "textures"), object_list(document.root, "images")
    texture = index_field(reference, "index", textures, "textures")
    if texture is None:
        return None
    extensions = object_field(textures[texture], "extensions")
    webp, ktx2 = (object_field(extensions, name) for name in ("EXT_texture_webp", "KHR_texture_basisu"))
    plain = textures[texture] if "source" in textures[texture] else ktx2
    source = index_field(webp or plain, "source", sources, "images")
    if source is None:
        return None
    if source not in images:
        images[source] = _image(document, sources[source], f"images[{source}]")
        refuse_many_pixels(png for png in images.values() if png is not None)
    return images[source]


def _image(document: GltfDocument, image: JsonObject, name: str) -> bytes | None:
    """Return an image as PNG; None, with a warning, if the file is missing or cannot be decoded here."""
    view = index_field(image, "bufferView", document.views, "bufferViews")
    uri = text_field(image, "uri")
    if view is not None:
        content: bytes | None = document.view_bytes(view)
    elif uri.startswith("data:"):
        content = uri_bytes(uri, document.companions)
    else:
        content = find_companion(uri, document.companions)
        name = unquote(uri)[:120]
    if content is None:
        message = f"texture {name!r} was not sent along; the model is used without it"
        document.warnings.append(SourceWarning(code="texture-missing", message=message))
        return None
    if content.startswith(KTX2_MAGIC):
        if has_ktx2():
            return ktx2_as_png(content, name)
        message = (
            f"texture {name!r} is KTX2, which is not decoded here; the model is used without it; send PNG or WebP, or "
            "pip install 'dynamictree[ktx2]'"
        )
        document.warnings.append(SourceWarning(code="texture-not-read", message=message))
        return None
    return texture_as_png(content, name)


def has_ktx2() -> bool:
    """Whether the transcoder is installed."""
    return find_spec("opengl_basisu") is not None


def ktx2_as_png(content: bytes, name: str) -> bytes:
    """Convert the largest level of a KTX 2 texture with a Basis Universal payload, the only one of glTF, to PNG.

    Raises:
        FormatError: no Basis Universal texture, damaged, or of more than `MAX_PIXELS`.
    """
    size_at = 20  # offset after the identifier, the format and the type's size
    import opengl_basisu

    if len(content) >= size_at + 8:
        width, height = struct.unpack_from("<II", content, size_at)
        if width * height > MAX_PIXELS:
            raise FormatError(f"texture {name!r} has {width} x {height} pixels; at most {MAX_PIXELS:,} are allowed")
    try:
        texture = opengl_basisu.open(content)
        pixels = texture.transcode("rgba8", level=0).data
    except (opengl_basisu.BasisuError, ValueError) as error:
        raise FormatError(f"texture {name!r} cannot be transcoded from KTX 2: {str(error)[:120]}") from error
    image = Image.fromarray(pixels, "RGBA")
    stream = io.BytesIO()
    (image if texture.has_alpha else image.convert("RGB")).save(stream, "PNG")
    return stream.getvalue()
