"""GLB with EXT_meshopt_compression: vertices, faces and keys packed by meshoptimizer.

Positions and texture coordinates become floats of fewer bits, normals become octahedral. Colours, joints, weights,
faces and keys stay as they are. A reader gets plain views back, by `decompressed`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
"""Of all views of a file that is read: what a file without compression may have."""

_POSITION_BITS, _UV_BITS, _NORMAL_BITS = 20, 15, 12


@dataclass(frozen=True, kw_only=True)
class _Stream:
    """A view as it is stored, and what its one accessor becomes."""

    rows: Shaped[np.ndarray, "count stride"]  # before the encoder, filtered if there is a filter
    mode: str = "ATTRIBUTES"
    filter: str = "NONE"
    accessor: tuple[tuple[str, object], ...] = ()  # fields that change
    change: Float32[np.ndarray, "count width"] | None = None  # of the decoded values


def load_meshopt() -> ModuleType:
    """The binding of meshoptimizer.

    Raises:
        InputError: it is not installed.
    """
    try:
        import meshopt
    except ImportError as error:
        raise InputError(f"{MESHOPT} {INSTALL}") from error
    return meshopt  # type: ignore[no-any-return]


def compress(writer: GlbWriter) -> dict[int, Float32[np.ndarray, "count width"]]:
    """Replace the views of a document under construction by compressed ones; give the changes by accessor.

    Raises:
        InputError: the binding of meshoptimizer is not installed.
    """
    meshopt = load_meshopt()
    content = b"".join(writer.chunks)
    views: list[dict[str, Any]] = writer.root.get("bufferViews", [])
    roles = _roles(writer.root)
    changes: dict[int, Float32[np.ndarray, "count width"]] = {}
    of_view = _accessor_of_view(writer.root, roles)
    writer.chunks, writer.num_bytes, unpacked = [], 0, 0
    for number, view in enumerate(views):
        start, length = view.get("byteOffset", 0), view["byteLength"]
        index = of_view.get(number)
        stream = None
        if index is not None and index in roles:
            accessor = writer.root["accessors"][index]
            if roles[index] == "keys":  # of all joints
                size = COMPONENTS[accessor["componentType"]].itemsize * WIDTHS.get(accessor["type"], 0)
                accessor = accessor | {"count": length // max(size, 1)}
            stream = _stream(meshopt, accessor, view, content, roles[index])
        packed = b"" if stream is None else meshopt.encode_gltf_buffer(stream.rows, stream.mode)
        if stream is None or not packed or len(packed) >= length:
            view["byteOffset"] = writer.add_bytes(content[start : start + length])
            continue
        assert index is not None
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
        if roles[index] not in ("faces", "keys"):  # whether or not the source states the view's target
            view["byteStride"] = stride
        unpacked += count * stride + -(count * stride) % 4
        writer.root["accessors"][index] |= dict(stream.accessor)
        if stream.change is not None:
            changes[index] = stream.change
    _declare(writer.root, unpacked)
    return changes


def decompressed(root: JsonObject, buffers: Sequence[bytes]) -> tuple[JsonObject, tuple[bytes, ...]]:
    """The document with plain views in place of compressed ones, which lie in a buffer of their own.

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
    """Whether a buffer only stands for what compressed views hold, without bytes of its own."""
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


def _roles(root: dict[str, Any]) -> dict[int, str]:
    """What the accessors are for that can be packed; those with several uses are left out."""
    triangle_list = 4
    uses: dict[int, set[str]] = {}

    def use(index: object, role: str) -> None:
        if isinstance(index, int):
            uses.setdefault(index, set()).add(role)

    for mesh in root.get("meshes", []):
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", triangle_list)
            use(primitive.get("indices"), "faces" if mode == triangle_list else "plain")
            for name, index in primitive["attributes"].items():
                use(index, name.partition("_")[0])
            for target in primitive.get("targets", []):
                for index in target.values():
                    use(index, "target")
    for skin in root.get("skins", []):
        use(skin.get("inverseBindMatrices"), "keys")
    for animation in root.get("animations", []):
        for sampler in animation["samplers"]:
            use(sampler["input"], "keys")
            use(sampler["output"], "keys")
    return {index: roles.pop() for index, roles in uses.items() if len(roles) == 1}


def _accessor_of_view(root: dict[str, Any], roles: Mapping[int, str]) -> dict[int, int]:
    """The accessor of each view that only one uses, from its first byte; the first of several of keys alike."""
    users: dict[int, list[int]] = {}
    for index, accessor in enumerate(root.get("accessors", [])):
        if "bufferView" in accessor:
            users.setdefault(accessor["bufferView"], []).append(index)
        for part in accessor.get("sparse", {}).values() if isinstance(accessor.get("sparse"), dict) else ():
            if isinstance(part, dict):
                users.setdefault(part["bufferView"], []).extend([-1, -1])
    kinds = [(roles.get(row), entry["componentType"], entry["type"]) for row, entry in enumerate(root["accessors"])]
    single = {
        view: rows[0]
        for view, rows in users.items()
        if len(rows) == 1 or (min(rows) >= 0 and [kind[0] for kind in {kinds[row] for row in rows}] == ["keys"])
    }
    return {
        view: index
        for view, index in single.items()
        if not root["accessors"][index].get("byteOffset", 0) and "sparse" not in root["accessors"][index]
    }


def _rows(accessor: dict[str, Any], view: dict[str, Any], content: bytes) -> Shaped[np.ndarray, "count stride"] | None:
    """The bytes of each element; None where the view holds more than its accessor."""
    size = COMPONENTS[accessor["componentType"]].itemsize * WIDTHS.get(accessor["type"], 0)
    stride = view.get("byteStride", size)
    count = accessor["count"]
    if not size or not count or view["byteLength"] not in (count * stride, stride * (count - 1) + size):
        return None
    start = view.get("byteOffset", 0)
    padded = content[start : start + view["byteLength"]].ljust(count * stride, b"\0")
    return np.frombuffer(padded, np.uint8).reshape(count, stride)


def _floats(accessor: dict[str, Any], rows: Shaped[np.ndarray, "count stride"]) -> Float32[np.ndarray, "n w"] | None:
    width = WIDTHS[accessor["type"]]
    if COMPONENTS[accessor["componentType"]] != np.float32 or rows.shape[1] != 4 * width:
        return None
    values: Float32[np.ndarray, "n w"] = np.ascontiguousarray(rows).view(np.float32)
    return values if np.isfinite(values).all() else None


def _stream(
    meshopt: ModuleType, accessor: dict[str, Any], view: dict[str, Any], content: bytes, role: str
) -> _Stream | None:
    """How the view of an accessor is stored; None where it stays as it is."""
    rows = _rows(accessor, view, content)
    if rows is None:
        return None
    if role == "faces":
        kind = COMPONENTS[accessor["componentType"]]
        if kind not in (np.uint16, np.uint32) or accessor["count"] % 3:
            return None
        return _Stream(rows=rows.view(kind), mode="TRIANGLES")
    values = _floats(accessor, rows)
    if values is not None:
        if role == "POSITION":
            stream = _exponential(meshopt, values, _POSITION_BITS)
            decoded = values + stream.change
            bounds = (("min", decoded.min(axis=0).tolist()), ("max", decoded.max(axis=0).tolist()))
            return replace(stream, accessor=bounds)
        if role == "TEXCOORD":
            return _exponential(meshopt, values, _UV_BITS)
        if role == "NORMAL" and values.shape[1] == 3:
            return _octahedral(meshopt, values)
    if role == "plain" or rows.shape[1] % 4 or rows.shape[1] > 256:
        return None
    return _Stream(rows=rows)


def _exponential(meshopt: ModuleType, values: Float32[np.ndarray, "n w"], bits: int) -> _Stream:
    """Floats with mantissas of so many bits, and one exponent a component."""
    filtered = meshopt.encode_filter_exp(values, bits, "SharedComponent")
    decoded = _unfiltered(meshopt, filtered, "EXPONENTIAL").view(np.float32)
    return _Stream(rows=filtered, filter="EXPONENTIAL", change=decoded - values)


def _octahedral(meshopt: ModuleType, normals: Float32[np.ndarray, "n 3"]) -> _Stream:
    padded = np.pad(normals, ((0, 0), (0, 1)))
    filtered = meshopt.encode_filter_oct(padded, 8, _NORMAL_BITS)
    fields = (("componentType", component_number(np.int16)), ("normalized", True))
    return _Stream(rows=filtered, filter="OCTAHEDRAL", accessor=fields)


def _unfiltered(meshopt: ModuleType, rows: Shaped[np.ndarray, "n s"], kind: str) -> Shaped[np.ndarray, "n s"]:
    stored = meshopt.encode_vertex_buffer(rows)
    decoded: Shaped[np.ndarray, "n s"] = meshopt.decode_vertex_buffer(stored, len(rows), rows.shape[1], kind)
    return decoded
