"""GLB containers as tables: their JSON, and accessors as arrays. Only what splats need; nothing outside of the file."""

import json
import struct
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from dynamictree.errors import FormatError
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.formats.stream import ByteWriter

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_MAX_JSON = 64 * 1024 * 1024  # bytes
_COMPONENTS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True, kw_only=True)
class GlbFile:
    """A GLB file's JSON and its one binary buffer."""

    document: dict[str, object]
    binary: UInt8[np.ndarray, " bytes"]

    def accessor_count(self, index: int) -> int:
        """How many rows an accessor says it has, bounded by what the buffer can hold."""
        accessor = self._accessor(index)
        count = integer(accessor, "count", 0)
        if not 0 < count <= len(self.binary):
            raise FormatError(
                f"accessor {index} of the GLB file has {count:,} rows, its buffer {len(self.binary):,} bytes"
            )
        return count

    def read_accessor(self, index: int) -> Float32[np.ndarray, "rows width"]:
        """An accessor's values; integers that are normalised become shares of their range."""
        accessor, count = self._accessor(index), self.accessor_count(index)
        component, shape = integer(accessor, "componentType", 0), str(accessor.get("type"))
        if component not in _COMPONENTS or shape not in _WIDTHS or "sparse" in accessor:
            raise FormatError(
                f"accessor {index} of the GLB file is of type {component} {shape}, or sparse; not understood"
            )
        kind, width = np.dtype(_COMPONENTS[component]).newbyteorder("<"), _WIDTHS[shape]
        views, view_index = listed(self.document, "bufferViews"), integer(accessor, "bufferView", -1)
        if not 0 <= view_index < len(views) or integer(views[view_index], "buffer", 0) != 0:
            raise FormatError(
                f"accessor {index} of the GLB file names buffer view {view_index}, which is not in the file"
            )
        view = views[view_index]
        stride = integer(view, "byteStride", kind.itemsize * width)
        within = integer(accessor, "byteOffset", 0)
        start, length = integer(view, "byteOffset", 0), integer(view, "byteLength", 0)
        needed = within + stride * (count - 1) + kind.itemsize * width
        if (
            min(start, within) < 0
            or stride < kind.itemsize * width
            or needed > length
            or start + length > len(self.binary)
        ):
            raise FormatError(
                f"accessor {index} of the GLB file needs {needed:,} bytes of a view of {length:,} at {start:,}, "
                f"the buffer has {len(self.binary):,}; the file is truncated or wrong"
            )
        raw = np.lib.stride_tricks.as_strided(
            self.binary[start + within :], (count, kind.itemsize * width), (stride, 1)
        )
        values = np.ascontiguousarray(raw).view(kind)
        if accessor.get("normalized") is True and kind.kind in "iu":
            largest = np.float32(2 ** (8 * kind.itemsize - (kind.kind == "i")) - 1)
            return np.maximum(values / largest, -1).astype(np.float32)
        return values.astype(np.float32)

    def _accessor(self, index: int) -> dict[str, object]:
        accessors = listed(self.document, "accessors")
        if not 0 <= index < len(accessors):
            raise FormatError(f"the GLB file names accessor {index} of {len(accessors)}")
        return accessors[index]


def read_glb(stream: SeekableReader) -> GlbFile:
    """Read both chunks.

    Raises:
        FormatError: not GLB 2, truncated, or JSON that is none.
    """
    head = stream.read(12)
    if len(head) < 12 or struct.unpack("<II", head[:8]) != (_MAGIC, 2):
        raise FormatError("the file does not begin as GLB version 2; it is no GLB file")
    content = _chunk(stream, _JSON, _MAX_JSON)
    binary = _chunk(stream, _BIN, 1 << 32) if remaining_bytes(stream) >= 8 else b""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"the JSON of the GLB file cannot be read: {error}") from error
    if not isinstance(document, dict):
        raise FormatError("the JSON of the GLB file is no object")
    return GlbFile(document=document, binary=np.frombuffer(binary, np.uint8))


def write_glb(
    attributes: dict[str, Float32[np.ndarray, "..."]], extensions: dict[str, object], stream: ByteWriter
) -> None:
    """Write one node with one primitive of points, each attribute in a view of its own."""
    accessors, views, place = list[dict[str, object]](), list[dict[str, object]](), 0
    for name, values in attributes.items():
        width = 1 if values.ndim == 1 else values.shape[1]
        accessor: dict[str, object] = {"bufferView": len(views), "componentType": 5126, "count": len(values)}
        accessor["type"] = next(shape for shape, number in _WIDTHS.items() if number == width)
        if name == "POSITION":
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": place, "byteLength": values.size * 4})
        place += values.size * 4
    primitive = {"attributes": {name: i for i, name in enumerate(attributes)}, "mode": 0, "extensions": extensions}
    document = {
        "asset": {"version": "2.0", "generator": "dynamictree"},
        "extensionsUsed": list(extensions),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": place}],
    }
    content = json.dumps(document, separators=(",", ":")).encode()
    content += b" " * (-len(content) % 4)
    stream.write(struct.pack("<III", _MAGIC, 2, 12 + 8 + len(content) + 8 + place))
    stream.write(struct.pack("<II", len(content), _JSON) + content + struct.pack("<II", place, _BIN))
    for values in attributes.values():
        stream.write(np.ascontiguousarray(values, "<f4").tobytes())


def member(container: dict[str, object], name: str) -> dict[str, object]:
    """An object within an object; empty where it is absent."""
    value = container.get(name, {})
    if not isinstance(value, dict):
        raise FormatError(f"{name!r} in the GLB file's JSON is no object")
    return value


def array(container: dict[str, object], name: str) -> list[object]:
    """A list within an object; empty where it is absent."""
    value = container.get(name, [])
    if not isinstance(value, list):
        raise FormatError(f"{name!r} in the GLB file's JSON is no list")
    return value


def listed(container: dict[str, object], name: str) -> list[dict[str, object]]:
    """A list of objects within an object; empty where it is absent."""
    values = array(container, name)
    if not all(isinstance(value, dict) for value in values):
        raise FormatError(f"{name!r} in the GLB file's JSON is no list of objects")
    return [value for value in values if isinstance(value, dict)]


def integer(container: dict[str, object], name: str, default: int) -> int:
    """A whole number within an object."""
    value = container.get(name, default)
    if not isinstance(value, int) or isinstance(value, bool):
        raise FormatError(f"{name!r} in the GLB file's JSON is {str(value)[:80]}; a whole number is needed")
    return value


def _chunk(stream: SeekableReader, kind: int, largest: int) -> bytes:
    head = stream.read(8)
    if len(head) < 8:
        raise FormatError("the GLB file ends before its JSON; it is truncated")
    length, found = struct.unpack("<II", head)
    if found != kind or length > min(largest, remaining_bytes(stream)):
        raise FormatError(
            f"a chunk of the GLB file is of type {found:#x} and {length:,} bytes; {kind:#x} and at most "
            f"{min(largest, remaining_bytes(stream)):,} are expected"
        )
    return stream.read(length)
