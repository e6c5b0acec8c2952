"""GLB with EXT_meshopt_compression: vertices, faces and keys packed by meshoptimizer.

Positions and texture coordinates become floats of fewer bits, normals become octahedral. Colours, joints, weights,
faces and keys are lossless. For readers, `decompressed` restores plain views.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float32, Shaped

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.gltf.layout import COMPONENTS, WIDTHS, component_number
from dynamictree.formats.gltf.writer import GlbWriter
from dynamictree.formats.json_fields import (
    JsonObject,
    index_field,
    integer_field,
    object_field,
    object_list,
    text_field,
    text_list,
)

MESHOPT, KHR_MESHOPT, QUANTIZATION = "EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_mesh_quantization"
INSTALL = "needs the Python module meshopt, which is not installed: pip install 'dynamictree[meshopt]'"
MAX_DECODED_BYTES = 1 << 30
"""Limit of all views of a file together, the same as of a file without compression."""

_POSITION_BITS, _UV_BITS, _NORMAL_BITS = 20, 15, 12


@dataclass(frozen=True, kw_only=True)
class _Stream:
    """A view as it is stored, and the changes to its accessor."""

    rows: Shaped[np.ndarray, "count stride"]  # input of the encoder, after the filter if there is one
    mode: str = "ATTRIBUTES"
    filter: str = "NONE"
    accessor: tuple[tuple[str, object], ...] = ()  # fields that change


def load_meshopt() -> ModuleType:
    """Import the Python binding of meshoptimizer.

    Raises:
        InputError: it is not installed.
    """
    try:
        import meshopt
    except ImportError as error:
        raise InputError(f"{MESHOPT} {INSTALL}") from error
    return meshopt  # type: ignore[no-any-return]


def compress(writer: GlbWriter) -> Float32[np.ndarray, "N 3"]:
    """Compress the views of a document of one mesh, and return the changes of its positions.

    Each accessor has a view of its own, except those of keys, which may share one.

    Raises:
        InputError: the binding of meshoptimizer is not installed.
    """
    meshopt, root, content = load_meshopt(), writer.root, b"".join(writer.chunks)
    primitives = root["meshes"][0]["primitives"]
    names = {index: name for name, index in primitives[0]["attributes"].items()}
    names |= {primitive["indices"]: "faces" for primitive in primitives}
    of_view: dict[int, int] = {}
    for index, accessor in enumerate(root["accessors"]):
        of_view.setdefault(accessor["bufferView"], index)
    before = _positions(root, content)
    after = before
    writer.chunks, writer.num_bytes, unpacked = [], 0, 0
    for number, view in enumerate(root["bufferViews"]):
        start, length = view["byteOffset"], view["byteLength"]
        index, stored = of_view.get(number, -1), content[start : start + length]
        stream = None if index < 0 else _stream(meshopt, root["accessors"][index], names.get(index, "keys"), stored)
        packed = b"" if stream is None else meshopt.encode_gltf_buffer(stream.rows, stream.mode)
        if stream is None or not packed or len(packed) >= length:
            view["byteOffset"] = writer.add_bytes(stored)
            continue
        count, stride = stream.rows.shape[0], stream.rows.itemsize * stream.rows.shape[1]
        view["extensions"] = {
            MESHOPT: {
                "buffer": 0,
                "byteOffset": writer.add_bytes(packed),
                "byteLength": len(packed),
                "byteStride": stride,
                "count": count,
                "mode": stream.mode,
                **({} if stream.filter == "NONE" else {"filter": stream.filter}),
            }
        }
        view |= {"buffer": 1, "byteOffset": unpacked, "byteLength": count * stride}
        if index in names and names[index] != "faces":
            view["byteStride"] = stride
        unpacked += count * stride + -(count * stride) % 4
        root["accessors"][index] |= dict(stream.accessor)
        if names.get(index) == "POSITION":
            after = _unfiltered(meshopt, stream.rows, stream.filter).view(np.float32)
    _declare(root, unpacked)
    return np.asarray(after - before)


def decompressed(root: JsonObject, buffers: Sequence[bytes]) -> tuple[JsonObject, tuple[bytes, ...]]:
    """Return the document with its compressed views replaced by plain ones, in a buffer of their own.

    Raises:
        FormatError: the binding is not installed, or a stream is damaged or too large.
    """
    views = object_list(root, "bufferViews")
    if not any(_extension(view) for view in views):
        return root, tuple(buffers)
    try:
        meshopt = load_meshopt()
    except InputError as error:
        raise FormatError(f"the file is compressed; reading it {INSTALL}") from error
    plain, chunks, num_bytes = [], list[bytes](), 0
    for number, view in enumerate(views):
        extension = _extension(view)
        if not extension:
            plain.append(view)
            continue
        content = _decoded(meshopt, extension, buffers, f"bufferViews[{number}]", MAX_DECODED_BYTES - num_bytes)
        rest = {name: value for name, value in view.items() if name not in ("extensions", "byteStride")}
        stride = {"byteStride": view["byteStride"]} if "byteStride" in view else {}
        plain.append(rest | stride | {"buffer": len(buffers), "byteOffset": num_bytes, "byteLength": len(content)})
        content += b"\0" * (-len(content) % 4)
        chunks.append(content)
        num_bytes += len(content)
    entries = [
        {name: value for name, value in entry.items() if name != "extensions"} for entry in object_list(root, "buffers")
    ]
    changed: dict[str, object] = {**root, "bufferViews": plain, "buffers": [*entries, {"byteLength": num_bytes}]}
    for name in ("extensionsUsed", "extensionsRequired"):
        others = [used for used in text_list(root, name) if used not in (MESHOPT, KHR_MESHOPT)]
        changed.pop(name, None)
        changed |= {name: others} if others else {}
    return changed, (*buffers, b"".join(chunks))


def is_fallback(buffer: JsonObject) -> bool:
    """Whether a buffer is a placeholder of compressed views, without bytes of its own."""
    extensions = object_field(buffer, "extensions")
    return any(object_field(extensions, name).get("fallback") is True for name in (MESHOPT, KHR_MESHOPT))


def _extension(view: JsonObject) -> JsonObject:
    extensions = object_field(view, "extensions")
    return object_field(extensions, MESHOPT) or object_field(extensions, KHR_MESHOPT)


def _decoded(meshopt: ModuleType, entry: JsonObject, buffers: Sequence[bytes], name: str, allowed: int) -> bytes:
    buffer = index_field(entry, "buffer", buffers, "buffers")
    if buffer is None:
        raise FormatError(f"the compressed {name} names no buffer")
    start = integer_field(entry, "byteOffset", high=1 << 40, default=0)
    length = integer_field(entry, "byteLength", high=1 << 40)
    count, stride = integer_field(entry, "count", high=1 << 32), integer_field(entry, "byteStride", high=256)
    if start + length > len(buffers[buffer]):
        raise FormatError(f"the compressed {name} ends at byte {start + length} of {len(buffers[buffer])}; truncated")
    if count * stride > allowed:
        raise FormatError(
            f"compressed views of the file hold more than {MAX_DECODED_BYTES:,} bytes; decimate the mesh first"
        )
    mode, kind = text_field(entry, "mode"), text_field(entry, "filter", "NONE")
    try:
        rows = meshopt.decode_gltf_buffer(buffers[buffer][start : start + length], count, stride, mode, kind)
    except ValueError as error:
        raise FormatError(f"the compressed {name} cannot be decoded: {error}") from error
    return bytes(np.ascontiguousarray(rows).tobytes())


def _declare(root: dict[str, Any], unpacked: int) -> None:
    if not unpacked:
        return
    (first,) = root.get("buffers", [{}])
    root["buffers"] = [first, {"byteLength": unpacked, "extensions": {MESHOPT: {"fallback": True}}}]
    for name in ("extensionsUsed", "extensionsRequired"):
        root[name] = [*root.get(name, []), *(new for new in (MESHOPT, QUANTIZATION) if new not in root.get(name, []))]


def _positions(root: dict[str, Any], content: bytes) -> Float32[np.ndarray, "N 3"]:
    accessor = root["accessors"][root["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    start: int = root["bufferViews"][accessor["bufferView"]]["byteOffset"]
    count: int = accessor["count"]
    positions: Float32[np.ndarray, "N 3"] = np.frombuffer(content, np.float32, 3 * count, start).reshape(count, 3)
    return positions


def _stream(meshopt: ModuleType, accessor: dict[str, Any], name: str, content: bytes) -> _Stream:
    """Choose how an accessor's view is stored, by the name of its attribute."""
    values = np.frombuffer(content, COMPONENTS[accessor["componentType"]]).reshape(-1, WIDTHS[accessor["type"]])
    if name == "faces":
        return _Stream(rows=values, mode="TRIANGLES")
    bits = {"POSITION": _POSITION_BITS, "TEXCOORD_0": _UV_BITS}
    if name in bits and np.isfinite(values).all():
        filtered = meshopt.encode_filter_exp(values, bits[name], "SharedComponent")  # one exponent per component
        decoded = _unfiltered(meshopt, filtered, "EXPONENTIAL").view(np.float32)
        bounds = (("min", decoded.min(axis=0).tolist()), ("max", decoded.max(axis=0).tolist()))
        return _Stream(rows=filtered, filter="EXPONENTIAL", accessor=bounds if name == "POSITION" else ())
    return _octahedral(meshopt, values) if name == "NORMAL" else _Stream(rows=values.view(np.uint8))


def _octahedral(meshopt: ModuleType, normals: Float32[np.ndarray, "n 3"]) -> _Stream:
    padded = np.pad(normals, ((0, 0), (0, 1)))
    filtered = meshopt.encode_filter_oct(padded, 8, _NORMAL_BITS)
    fields = (("componentType", component_number(np.int16)), ("normalized", True))
    return _Stream(rows=filtered, filter="OCTAHEDRAL", accessor=fields)


def _unfiltered(meshopt: ModuleType, rows: Shaped[np.ndarray, "n s"], kind: str) -> Shaped[np.ndarray, "n s"]:
    stored = meshopt.encode_vertex_buffer(rows)
    decoded: Shaped[np.ndarray, "n s"] = meshopt.decode_vertex_buffer(stored, len(rows), rows.shape[1], kind)
    return decoded
