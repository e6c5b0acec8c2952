"""Materials and texture coordinates of glTF, as far as the base colour goes."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32, Shaped

from dynamictree.errors import FormatError
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
from dynamictree.formats.texture import refuse_many_pixels, texture_as_png
from dynamictree.mesh import Material

_BLEND_CUTOFF = 0.5  # leaves drawn by blending are cut out instead; depth-sorted blending is not ours to do


def gltf_materials(document: GltfDocument) -> tuple[Material, ...]:
    """The file's materials in its order; each image is decoded once."""
    images: dict[int, bytes] = {}
    return tuple(_material(document, entry, images) for entry in object_list(document.root, "materials"))


def texture_coordinates(
    attributes: Mapping[str, Shaped[np.ndarray, "n width"]], material: JsonObject | None, count: int
) -> Float32[np.ndarray, "n 2"] | None:
    """The set that the base colour's texture asks for, KHR_texture_transform applied."""
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
    bounded: Float32[np.ndarray, "n 2"] = np.clip(moved, -1e6, 1e6).astype(np.float32)
    return bounded


def texture_placement(material: JsonObject) -> str:
    """What distinguishes the texture coordinates of two materials."""
    texture = _base_texture(material)
    return repr((texture.get("texCoord"), texture.get("extensions")))


def _base_texture(material: JsonObject) -> JsonObject:
    return object_field(object_field(material, "pbrMetallicRoughness"), "baseColorTexture")


def _material(document: GltfDocument, entry: JsonObject, images: dict[int, bytes]) -> Material:
    surface = object_field(entry, "pbrMetallicRoughness")
    red, green, blue, alpha = (min(max(v, 0.0), 1.0) for v in numbers_field(surface, "baseColorFactor", 4, (1.0,) * 4))
    mode = text_field(entry, "alphaMode", "OPAQUE")
    cutoffs = {"OPAQUE": None, "MASK": number_field(entry, "alphaCutoff", 0.5), "BLEND": _BLEND_CUTOFF}
    if mode not in cutoffs:
        raise FormatError(f"alphaMode is {mode[:20]!r}; {', '.join(cutoffs)} are defined")
    return Material(
        name=text_field(entry, "name")[:200],
        base_color=(red, green, blue, alpha),
        texture_png=_texture(document, _base_texture(entry), images),
        alpha_cutoff=cutoffs[mode],
        double_sided=entry.get("doubleSided") is True,
    )


def _texture(document: GltfDocument, reference: JsonObject, images: dict[int, bytes]) -> bytes | None:
    textures, sources = object_list(document.root, "textures"), object_list(document.root, "images")
    texture = index_field(reference, "index", textures, "textures")
    if texture is None:
        return None
    webp = object_field(object_field(textures[texture], "extensions"), "EXT_texture_webp")
    source = index_field(webp or textures[texture], "source", sources, "images")
    if source is None:
        return None
    if source not in images:
        view = index_field(sources[source], "bufferView", document.views, "bufferViews")
        uri = text_field(sources[source], "uri")
        content = document.view_bytes(view) if view is not None else uri_bytes(uri, document.companions)
        images[source] = texture_as_png(content, f"images[{source}]")
        refuse_many_pixels(images.values())
    return images[source]
