"""The document that a mesh was read from, with all of its files inside, so that a writer can return everything in it.

Buffers become one, images move into it, Draco streams become plain accessors, and GPU instances become nodes. Nothing
else changes: materials, textures, attributes, nodes, names, extras, extensions, skins and animations stay as they are.
"""

import base64
import json
import mimetypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Shaped

from dynamictree.errors import FormatError
from dynamictree.formats.companions import KTX2_MAGIC, find_companion
from dynamictree.formats.gltf.document import GltfDocument, uri_bytes
from dynamictree.formats.gltf.layout import COMPONENTS, component_number
from dynamictree.formats.gltf.scene import MeshInstance
from dynamictree.formats.gltf.writer import GlbWriter
from dynamictree.formats.json_fields import object_list, text_field
from dynamictree.mesh import SourceGltf, SourceWarning

MAX_SOURCE_PRIMITIVES = 4000
"""Primitives with 31 targets each are 30 MB of JSON; players take seconds to parse it."""
INSTANCING, DRACO, LEVELS = "EXT_mesh_gpu_instancing", "KHR_draco_mesh_compression", "MSFT_lod"
_PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEAsTj2FAAAAABJRU5ErkJggg=="
)
"""A white pixel that stands where an image was not sent along, so that the others keep their numbers."""
_IMAGE_MAGIC = (
    (b"\x89PNG\r\n\x1a\n", "image/png"),
    (b"\xff\xd8\xff", "image/jpeg"),
    (KTX2_MAGIC, "image/ktx2"),
)


@dataclass(frozen=True, kw_only=True)
class PlacedPrimitive:
    """A primitive of the document, and where its vertices are in the mesh."""

    instance: MeshInstance
    primitive: int  # of the instance's mesh
    first_vertex: int
    num_vertices: int
    decoded: Mapping[str, Shaped[np.ndarray, "n width"]] | None  # of its Draco stream; INDICES are the faces' corners


def keep_source(document: GltfDocument, placed: Sequence[PlacedPrimitive]) -> SourceGltf | None:
    """The document for writers; None, with a warning, where it is too large or breaks the specification."""
    max_source_bytes = 256 << 20  # of a document with its files: what a job can hold in memory beside the motion
    try:
        files = _files(document)
        num_bytes = sum(map(len, document.buffers)) + sum(map(len, files.values()))
        if len(placed) > MAX_SOURCE_PRIMITIVES or num_bytes > max_source_bytes:
            allowed = f"{MAX_SOURCE_PRIMITIVES:,} and {max_source_bytes:,} are allowed for that"
            why = f"it has {len(placed):,} parts and {num_bytes:,} bytes; {allowed}"
        else:
            return _source(document, placed, files)
    except (FormatError, KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError) as error:
        why = f"a part of it that is not needed for the motion is damaged: {str(error)[:80]}"
    message = f"GLB export cannot return the file's materials and nodes unchanged, only base colours: {why}"
    document.warnings.append(SourceWarning(code="looks-reduced", message=message))
    return None


def _source(document: GltfDocument, placed: Sequence[PlacedPrimitive], files: Mapping[int, bytes]) -> SourceGltf:
    merged = GlbWriter(root=json.loads(json.dumps(document.root, allow_nan=False), parse_float=_number))
    _merge_buffers(document, merged)
    _embed_images(merged, files)
    _drop_dead_images(merged, files)
    _decode_draco(merged, placed)
    nodes = _instances_as_nodes(merged, placed)
    if not merged.root.get("scenes"):
        children = {child for node in merged.root["nodes"] for child in node.get("children", [])}
        merged.root["scenes"] = [{"nodes": [n for n in range(len(merged.root["nodes"])) if n not in children]}]
    _warn_of_motion(document)
    _forget_levels(document, merged.root)
    rows = [[node, p.primitive, p.first_vertex, p.num_vertices] for node, p in zip(nodes, placed, strict=True)]
    return SourceGltf(
        document=json.dumps(merged.root, separators=(",", ":")).encode(),
        binary=tuple(merged.chunks),
        primitives=np.array(rows, np.int32).reshape(-1, 4),
    )


def _number(text: str) -> int | float:
    """Convert a JSON number to an integer; some writers write indices as 3.0."""
    value = float(text)
    return int(value) if value.is_integer() and abs(value) < 2**53 else value


def _files(document: GltfDocument) -> dict[int, bytes]:
    """Content of the images that lie outside of the buffers and were sent along, by their index."""
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
        image["mimeType"] = _mime_type(content, str(image.get("mimeType", "")), uri)
        image["bufferView"] = merged.add_view(content)


def _drop_dead_images(merged: GlbWriter, files: Mapping[int, bytes]) -> None:
    """Take the textures of images that were not sent along from the materials: a name without a file is an error."""
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


def _mime_type(content: bytes, stated: str, uri: str) -> str:
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "image/webp"
    by_bytes = next((kind for magic, kind in _IMAGE_MAGIC if content.startswith(magic)), "")
    return by_bytes or stated or mimetypes.guess_type(uri)[0] or "application/octet-stream"


def _decode_draco(merged: GlbWriter, placed: Sequence[PlacedPrimitive]) -> None:
    """Write what Draco streams hold as accessors; the streams' bytes stay in the buffer, unused."""
    accessors: list[dict[str, Any]] = merged.root.get("accessors", [])
    done: set[tuple[int, int]] = set()
    for part in placed:
        key = (int(merged.root["nodes"][part.instance.node]["mesh"]), part.primitive)
        if part.decoded is None or key in done:
            continue
        done.add(key)
        primitive = merged.root["meshes"][key[0]]["primitives"][key[1]]
        named = primitive["extensions"].pop(DRACO)["attributes"]
        if not primitive["extensions"]:
            del primitive["extensions"]
        for name in named:
            if name in part.decoded and name in primitive["attributes"]:
                old = accessors[int(primitive["attributes"][name])]
                primitive["attributes"][name] = _add_accessor(merged, old, part.decoded[name])
        old = accessors[int(primitive["indices"])] if "indices" in primitive else {"type": "SCALAR"}
        corners = part.decoded["INDICES"].astype(np.uint32)
        primitive["indices"] = _add_accessor(merged, {**old, "componentType": component_number(np.uint32)}, corners)
    if done and not any(DRACO in str(mesh) for mesh in merged.root["meshes"]):
        _forget_extension(merged.root, DRACO)


def _add_accessor(merged: GlbWriter, old: Mapping[str, Any], elements: Shaped[np.ndarray, "n width"]) -> int:
    stored = np.ascontiguousarray(elements, COMPONENTS[int(old["componentType"])])
    padding = -(stored.itemsize * stored.shape[1]) % 4  # vertices start at multiples of four bytes
    view = merged.add_view(np.pad(stored.view(np.uint8).reshape(len(stored), -1), ((0, 0), (0, padding))).tobytes())
    if padding:
        merged.root["bufferViews"][view]["byteStride"] = stored.itemsize * stored.shape[1] + padding
    entry = {name: value for name, value in old.items() if name not in ("byteOffset", "sparse")}
    if "min" in entry or "max" in entry:  # those of the file are of the mesh before Draco rounded it
        entry |= {"min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist()} if len(stored) else {}
    merged.root["accessors"].append(entry | {"bufferView": view, "count": len(stored)})
    return len(merged.root["accessors"]) - 1


def _instances_as_nodes(merged: GlbWriter, placed: Sequence[PlacedPrimitive]) -> list[int]:
    """The node of each primitive, after each place of an instanced mesh has become a node below it."""
    nodes: list[dict[str, Any]] = merged.root["nodes"]
    node_of: dict[tuple[int, int], int] = {}
    meshes: dict[int, int] = {}
    result = []
    for part in placed:
        instance = part.instance
        if instance.place is None:
            result.append(instance.node)
            continue
        above = nodes[instance.node]
        if instance.node not in meshes:
            meshes[instance.node] = above.pop("mesh")
            del above["extensions"][INSTANCING]
            if not above["extensions"]:
                del above["extensions"]
        key = (instance.node, instance.place)
        if key not in node_of:
            node_of[key] = len(nodes)
            above.setdefault("children", []).append(len(nodes))
            matrix = instance.placed.T.ravel().tolist()  # stored by columns
            nodes.append({"mesh": meshes[instance.node], "matrix": matrix})
        result.append(node_of[key])
    if node_of and not any(INSTANCING in node.get("extensions", {}) for node in nodes):
        _forget_extension(merged.root, INSTANCING)
    return result


def _forget_extension(root: dict[str, Any], name: str) -> None:
    for listed in ("extensionsUsed", "extensionsRequired"):
        rest = [other for other in root.pop(listed, []) if other != name]
        if rest:
            root[listed] = rest


def _forget_levels(document: GltfDocument, root: dict[str, Any]) -> None:
    """Take the coarser levels of detail from the nodes, with a warning: beside the finest, which moves, they stand."""
    nodes = [node for node in root["nodes"] if LEVELS in node.get("extensions", {})]
    for node in nodes:
        del node["extensions"][LEVELS]
    if not nodes:
        return
    if not any(LEVELS in entry.get("extensions", {}) for entry in root.get("materials", [])):
        _forget_extension(root, LEVELS)
    message = (
        f"{len(nodes)} nodes have levels of detail ({LEVELS}); only the finest level moves, so GLB export shows "
        "it at every distance; ask for the format lod for levels that move"
    )
    document.warnings.append(SourceWarning(code="levels-left-out", message=message))


def _warn_of_motion(document: GltfDocument) -> None:
    """Say that a file's own animations are no part of ours."""
    animations = object_list(document.root, "animations")
    if not animations:
        return
    names = ", ".join(repr(str(entry.get("name", "unnamed"))[:40]) for entry in animations[:5])
    message = (
        f"the file comes with animations ({len(animations)}: {names}), which are not part of the motion; glb "
        "leaves them in the file after 'sway', other formats drop them"
    )
    document.warnings.append(SourceWarning(code="animations-ignored", message=message))
