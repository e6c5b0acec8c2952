"""A glTF 2.0 document and its bytes: GLB or JSON, buffers, views and accessors, with bounds checked before use."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from jaxtyping import Shaped

from dynamictree.byte_stream import ByteReader
from dynamictree.errors import FormatError
from dynamictree.formats.companions import find_companion
from dynamictree.formats.gltf.layout import COMPONENTS, WIDTHS
from dynamictree.formats.gltf.meshopt import decompressed, is_fallback
from dynamictree.formats.json_fields import (
    JsonObject,
    index_field,
    integer_field,
    object_field,
    object_list,
    parse_object,
    text_field,
    text_list,
)
from dynamictree.mesh import MAX_FACES, SourceWarning

MAX_ELEMENTS = 3 * MAX_FACES  # elements per accessor: the indices of the largest mesh that is allowed

READ_EXTENSIONS = frozenset(
    {
        "KHR_draco_mesh_compression",
        "KHR_gaussian_splatting",
        "KHR_mesh_quantization",
        "KHR_texture_basisu",
        "KHR_meshopt_compression",
        "KHR_texture_transform",
        "EXT_mesh_gpu_instancing",
        "EXT_meshopt_compression",
        "EXT_texture_webp",
    }
)
"""Extensions of geometry or textures that the readers support."""

_OF_LIGHT = frozenset({"KHR_lights_punctual", "KHR_xmp_json_ld"})
"""Extensions that change neither geometry nor base colours; those of materials do not either."""
_MAGIC, _JSON_CHUNK, _BINARY_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942
_MAX_BYTES = 1 << 40


@dataclass(frozen=True, kw_only=True)
class GltfDocument:
    """glTF's JSON with the bytes of its buffers."""

    root: JsonObject
    buffers: tuple[bytes, ...]
    views: tuple[JsonObject, ...]
    accessors: tuple[JsonObject, ...]
    companions: Mapping[str, bytes]
    warnings: list[SourceWarning]  # warnings of parts that are skipped

    def view_bytes(self, index: int) -> bytes:
        """Return the bytes of a buffer view."""
        view = self.views[index]
        buffer = index_field(view, "buffer", self.buffers, "buffers")
        if buffer is None:
            raise FormatError(f"bufferViews[{index}] names no buffer")
        start = integer_field(view, "byteOffset", high=_MAX_BYTES, default=0)
        length = integer_field(view, "byteLength", high=_MAX_BYTES)
        if start + length > len(self.buffers[buffer]):
            raise FormatError(
                f"bufferViews[{index}] ends at byte {start + length}, but its buffer has {len(self.buffers[buffer])}; "
                "the file is truncated"
            )
        return self.buffers[buffer][start : start + length]

    def accessor(self, index: int) -> Shaped[np.ndarray, "count width"]:
        """Return the elements of an accessor as stored; normalised integers become float32."""
        accessor = self.accessors[index]
        count, dtype, width = accessor_layout(accessor, f"accessors[{index}]")
        view = index_field(accessor, "bufferView", self.views, "bufferViews")
        if view is None:
            elements = np.zeros((count, width), dtype)
        else:
            elements = self._strided(view, accessor, count, dtype, width)
        if "sparse" in accessor:
            elements = self._with_sparse(elements.copy(), object_field(accessor, "sparse"))
        if accessor.get("normalized") is True and dtype.kind in "iu":
            largest = 2 ** (8 * dtype.itemsize - (dtype.kind == "i")) - 1
            elements = np.maximum(elements.astype(np.float32) / np.float32(largest), np.float32(-1))
        return elements

    def _strided(
        self, view: int, accessor: JsonObject, count: int, dtype: np.dtype[np.generic], width: int
    ) -> Shaped[np.ndarray, "count width"]:
        content = self.view_bytes(view)
        start = integer_field(accessor, "byteOffset", high=_MAX_BYTES, default=0)
        size = dtype.itemsize * width
        stride = integer_field(self.views[view], "byteStride", high=252, default=0) or size
        end = start + stride * (count - 1) + size if count else start
        if stride < size or end > len(content):
            raise FormatError(
                f"an accessor of {count} elements, {stride} bytes apart, ends at byte {end} of a view of "
                f"{len(content)}; the file is truncated or its header is wrong"
            )
        return np.ndarray((count, width), dtype, content, start, (stride, dtype.itemsize))

    def _with_sparse(
        self, elements: Shaped[np.ndarray, "count width"], sparse: JsonObject
    ) -> Shaped[np.ndarray, "count width"]:
        changed = integer_field(sparse, "count", high=len(elements))
        places, values = object_field(sparse, "indices"), object_field(sparse, "values")
        place_view, value_view = (
            index_field(part, "bufferView", self.views, "bufferViews") for part in (places, values)
        )
        if place_view is None or value_view is None:
            raise FormatError("a sparse accessor names no bufferView for its indices or values")
        rows = self._strided(place_view, places, changed, _component_type(places), 1)[:, 0]
        if rows.dtype.kind != "u" or (changed and rows.max() >= len(elements)):
            raise FormatError(f"a sparse accessor changes elements outside of its {len(elements)}")
        elements[rows] = self._strided(value_view, values, changed, elements.dtype, elements.shape[1])
        return elements


def open_gltf(content: bytes, *, companions: Mapping[str, bytes]) -> GltfDocument:
    """Open GLB or glTF JSON, and the buffers that it names.

    Raises:
        FormatError: truncated, not glTF 2.0, needs an extension that is not read, or a file that was not sent along.
    """
    text, binary = _split_glb(content) if content[:4] == _MAGIC else (content, None)
    root = parse_object(text, "glTF file")
    version = text_field(object_field(root, "asset"), "version", "none")
    if not version.startswith("2."):
        raise FormatError(f"the file is glTF {version[:20]}; 2.0 is read")
    required = {name for name in text_list(root, "extensionsRequired") if not name.startswith("KHR_materials_")}
    refused = sorted(required - READ_EXTENSIONS - _OF_LIGHT)
    if refused:
        raise FormatError(
            f"the file requires the glTF extension {', '.join(refused)[:200]}, which is not read; "
            f"export without it (read are {', '.join(sorted(READ_EXTENSIONS))})"
        )
    buffers = [_buffer(entry, i, binary, companions) for i, entry in enumerate(object_list(root, "buffers"))]
    root, plain_buffers = decompressed(root, buffers)
    return GltfDocument(
        root=root,
        buffers=plain_buffers,
        views=tuple(object_list(root, "bufferViews")),
        accessors=tuple(object_list(root, "accessors")),
        companions=companions,
        warnings=[],
    )


def glb_json(stream: ByteReader) -> JsonObject:
    """Read the JSON of a GLB file, and nothing after it.

    Raises:
        FormatError: not GLB 2, truncated, or invalid JSON.
    """
    max_json_bytes = 64 << 20
    head = stream.read(20)
    if len(head) < 20 or head[:8] != _MAGIC + (2).to_bytes(4, "little"):
        raise FormatError("the file does not begin as GLB version 2; it is no GLB file, or truncated")
    length = int.from_bytes(head[12:16], "little")
    if length > max_json_bytes or int.from_bytes(head[16:20], "little") != _JSON_CHUNK:
        raise FormatError(
            f"the first chunk of the GLB has {length:,} bytes; JSON of at most {max_json_bytes:,} is read"
        )
    return parse_object(stream.read(length), "GLB file")


def uri_bytes(uri: str, companions: Mapping[str, bytes]) -> bytes:
    """Return the content of a URI: embedded data, or a companion by its name; nothing else is opened."""
    if uri.startswith("data:"):
        head, _, body = uri.partition(",")
        try:
            return base64.b64decode(body, validate=True) if head.endswith(";base64") else unquote_to_bytes(body)
        except ValueError as error:
            raise FormatError(f"a data URI of the file is not base64: {error}") from error
    content = find_companion(uri, companions)
    if content is None:
        given = ", ".join(sorted(companions)[:8]) or "none"
        raise FormatError(
            f"the file names {unquote(uri)[:120]!r} outside itself (files given beside it: {given}); "
            "embed it, for instance as GLB, or send it along"
        )
    return content


def accessor_layout(accessor: JsonObject, name: str) -> tuple[int, np.dtype[np.generic], int]:
    """Return count, component type and width of an accessor, from its JSON alone."""
    kind = text_field(accessor, "type")
    if kind not in WIDTHS:
        raise FormatError(f"{name} is of type {kind[:20]!r}; {', '.join(WIDTHS)} are read")
    return integer_field(accessor, "count", high=MAX_ELEMENTS), _component_type(accessor), WIDTHS[kind]


def _component_type(accessor: JsonObject) -> np.dtype[np.generic]:
    number = integer_field(accessor, "componentType", high=65535)
    if number not in COMPONENTS:
        raise FormatError(f"a componentType is {number}; {', '.join(map(str, COMPONENTS))} are defined")
    return COMPONENTS[number]


def _split_glb(content: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON chunk and the binary chunk."""
    if len(content) < 20:
        raise FormatError(f"the GLB has {len(content)} bytes; it is truncated")
    version, length = (int.from_bytes(content[at : at + 4], "little") for at in (4, 8))
    if version != 2:
        raise FormatError(f"the file is GLB version {version}; 2 is read")
    if length > len(content):
        raise FormatError(f"the GLB says that it has {length} bytes, but {len(content)} are there; it is truncated")
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = (int.from_bytes(content[at + i : at + i + 4], "little") for i in (0, 4))
        if at + 8 + size > length:
            raise FormatError(f"a chunk of the GLB ends at byte {at + 8 + size} of {length}; it is truncated")
        chunks.setdefault(kind, content[at + 8 : at + 8 + size])
        at += 8 + size
    if _JSON_CHUNK not in chunks:
        raise FormatError("the GLB has no JSON chunk")
    return chunks[_JSON_CHUNK], chunks.get(_BINARY_CHUNK)


def _buffer(entry: JsonObject, index: int, binary: bytes | None, companions: Mapping[str, bytes]) -> bytes:
    if "uri" in entry:
        content = uri_bytes(text_field(entry, "uri"), companions)
    elif index == 0 and binary is not None:
        content = binary
    elif is_fallback(entry):
        return b""
    else:
        raise FormatError(f"buffers[{index}] has neither a uri nor the GLB's binary chunk")
    length = integer_field(entry, "byteLength", high=_MAX_BYTES)
    if length > len(content):
        raise FormatError(f"buffers[{index}] says {length} bytes, but {len(content)} are there; the file is truncated")
    return content[:length]
