"""The glTF document that a mesh was read from, with its files embedded, so that a writer preserves all of it.

Buffers are merged into one, and images move into it. Materials, textures, attributes, nodes, names, extras, extensions,
skins and animations do not change.
"""

import base64
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Int32

from dynamictree.errors import FormatError
from dynamictree.formats.companions import KTX2_MAGIC, find_companion
from dynamictree.formats.gltf.document import GltfDocument, uri_bytes
from dynamictree.formats.gltf.writer import GlbWriter
from dynamictree.formats.json_fields import object_field, object_list, text_field
from dynamictree.mesh import SourceGltf, SourceWarning

MAX_SOURCE_PRIMITIVES = 4000
"""Limit of primitives: players take seconds to parse the JSON of a skin for each."""
_PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEAsTj2FAAAAABJRU5ErkJggg=="
)
"""A white pixel that replaces a missing image, so that the others keep their indices."""
_IMAGE_MAGIC = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"), (KTX2_MAGIC, "image/ktx2"))


def keep_source(document: GltfDocument, primitives: Int32[np.ndarray, "P 4"]) -> SourceGltf | None:
    """Return the document for writers; None, with a warning, if it is too large or breaks the specification.

    `primitives` are those of the mesh, as in `SourceGltf`.
    """
    max_source_bytes = 256 << 20  # size of a document with its files that a job has memory for beside the motion
    try:
        files = _files(document)
        num_bytes = sum(map(len, document.buffers)) + sum(map(len, files.values()))
        if len(primitives) > MAX_SOURCE_PRIMITIVES or num_bytes > max_source_bytes:
            allowed = f"{MAX_SOURCE_PRIMITIVES:,} and {max_source_bytes:,} are allowed for that"
            why = f"it has {len(primitives):,} parts and {num_bytes:,} bytes; {allowed}"
        else:
            return _source(document, primitives, files)
    except (FormatError, KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError) as error:
        why = f"a part of it that is not needed for the motion is damaged: {str(error)[:80]}"
    message = f"GLB export cannot return the file's materials and nodes unchanged, only base colours: {why}"
    document.warnings.append(SourceWarning(code="looks-reduced", message=message))
    return None


def _source(document: GltfDocument, primitives: Int32[np.ndarray, "P 4"], files: Mapping[int, bytes]) -> SourceGltf:
    merged = GlbWriter(root=json.loads(json.dumps(document.root, allow_nan=False), parse_float=_number))
    _merge_buffers(document, merged)
    _embed_images(merged, files)
    _drop_dead_images(merged, files)
    if not merged.root.get("scenes"):
        children = {child for node in merged.root["nodes"] for child in node.get("children", [])}
        merged.root["scenes"] = [{"nodes": [n for n in range(len(merged.root["nodes"])) if n not in children]}]
    _warn_of_motion(document)
    text = json.dumps(merged.root, separators=(",", ":")).encode()
    return SourceGltf(document=text, binary=tuple(merged.chunks), primitives=primitives)


def _number(text: str) -> int | float:
    """Parse a JSON number, whole ones as integers: some writers write indices as 3.0."""
    value = float(text)
    return int(value) if value.is_integer() and abs(value) < 2**53 else value


def _files(document: GltfDocument) -> dict[int, bytes]:
    """Return the content of images outside the buffers that were sent along, by index."""
    files = {}
    for index, image in enumerate(object_list(document.root, "images")):
        uri = text_field(image, "uri")
        content = uri_bytes(uri, {}) if uri.startswith("data:") else find_companion(uri, document.companions)
        if content is not None:
            files[index] = content
    return files


def _merge_buffers(document: GltfDocument, merged: GlbWriter) -> None:
    starts = [merged.add_bytes(content) for content in document.buffers]
    for view in merged.root.get("bufferViews", []):
        view["byteOffset"] = int(view.get("byteOffset", 0)) + starts[int(view["buffer"])]
        view["buffer"] = 0
    first = (merged.root.get("buffers") or [{}])[0]
    merged.root["buffers"] = [{name: value for name, value in first.items() if name not in ("uri", "byteLength")}]


def _embed_images(merged: GlbWriter, files: Mapping[int, bytes]) -> None:
    for index, content in files.items():
        image = merged.root["images"][index]
        uri = image.pop("uri")
        if "name" not in image and not uri.startswith("data:"):
            image["name"] = uri
        kinds = [kind for magic, kind in _IMAGE_MAGIC if content.startswith(magic)]
        kinds += ["image/webp"] if content[:4] == b"RIFF" and content[8:12] == b"WEBP" else []
        image["mimeType"] = (kinds or [str(image.get("mimeType", "")) or "application/octet-stream"])[0]
        image["bufferView"] = merged.add_view(content)


def _drop_dead_images(merged: GlbWriter, files: Mapping[int, bytes]) -> None:
    """Remove the textures of missing images from the materials: a reference without a file is an error."""
    images = merged.root.get("images", [])
    dead = {index for index, image in enumerate(images) if "uri" in image and index not in files}
    if not dead:
        return
    unusable = set()
    for number, texture in enumerate(merged.root.get("textures", [])):
        extensions = texture.get("extensions", {})
        for name in [name for name, entry in extensions.items() if entry.get("source") in dead]:
            del extensions[name]
        if texture.get("source") in dead:
            del texture["source"]
        if "source" not in texture and not any("source" in entry for entry in extensions.values()):
            unusable.add(number)
    for material in merged.root.get("materials", []):
        _forget_textures(material, unusable)
    view = merged.add_view(_PIXEL)
    for index in dead:
        images[index] = {"name": str(images[index].get("name", images[index]["uri"])), "mimeType": "image/png"}
        images[index]["bufferView"] = view


def _forget_textures(entry: dict[str, Any], numbers: set[int]) -> None:
    for name, below in list(entry.items()):
        if isinstance(below, dict):
            if name.endswith("Texture") and below.get("index") in numbers:
                del entry[name]
            else:
                _forget_textures(below, numbers)


def _warn_of_motion(document: GltfDocument) -> None:
    """Warn that a file's own animations and its coarser levels of detail are not part of the motion."""
    levels = [node for node in object_list(document.root, "nodes") if "MSFT_lod" in object_field(node, "extensions")]
    if levels:
        message = (
            f"{len(levels)} nodes have levels of detail (MSFT_lod); only the finest level moves, and exports have no "
            "other; ask for the format lod for levels that move"
        )
        document.warnings.append(SourceWarning(code="levels-left-out", message=message))
    animations = object_list(document.root, "animations")
    if not animations:
        return
    names = ", ".join(repr(str(entry.get("name", "unnamed"))[:40]) for entry in animations[:5])
    message = (
        f"the file comes with animations ({len(animations)}: {names}), which are not part of the motion; glb has them "
        "after 'sway', unless the file has a skin, Draco, instances or levels of detail; other formats drop them"
    )
    document.warnings.append(SourceWarning(code="animations-ignored", message=message))
