"""Transfer of a mesh or a capture between processes: its dataclasses, field by field, as safetensors.

Internal format, written by the process that parses an upload, and read by those that must not parse it.
"""

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Shaped
from pydantic import ConfigDict, TypeAdapter
from safetensors import SafetensorError
from safetensors.numpy import load, save

from dynamictree.byte_stream import ByteReader, ByteWriter, read_all
from dynamictree.errors import FormatError
from dynamictree.gaussian.cloud import validate_cloud
from dynamictree.mesh import TriangleMesh, validate_mesh
from dynamictree.plant.capture import Capture

VERSION = 3
MAX_BYTES = {TriangleMesh: 1 << 30, Capture: 3 << 30}
_FIELDS, _TENSOR, _BYTES = "fields", "tensor", "bytes"
"""Name of the tensor with the JSON of the fields; keys in this JSON that refer to an array and to bytes."""

Tensors = Mapping[str, Shaped[np.ndarray, "..."]]
Value = TypeVar("Value", TriangleMesh, Capture)


def write_bundle(value: TriangleMesh | Capture, stream: ByteWriter) -> None:
    """Write all fields without loss."""
    tensors: dict[str, Shaped[np.ndarray, ...]] = {}

    def plain(part: object) -> object:
        if isinstance(part, bytes | np.ndarray):
            name = str(len(tensors))
            tensors[name] = np.ascontiguousarray(np.frombuffer(part, np.uint8) if isinstance(part, bytes) else part)
            return {_BYTES if isinstance(part, bytes) else _TENSOR: name}
        if is_dataclass(part):
            return {field.name: plain(getattr(part, field.name)) for field in fields(part)}
        return [plain(each) for each in part] if isinstance(part, tuple) else part

    text = json.dumps({"version": VERSION, type(value).__name__: plain(value)})
    stream.write(save(tensors | {_FIELDS: np.frombuffer(text.encode(), np.uint8)}))


def read_mesh_bundle(stream: ByteReader, *, with_source: bool = False) -> TriangleMesh:
    """Read a mesh of `write_bundle`; `with_source` adds its glTF document, which is large and only for GLB writers.

    Raises:
        FormatError: the file is no such bundle, or of another version.
        MeshError: the mesh in it cannot be used.
    """
    return _checked(_read(stream, TriangleMesh, leave_out=() if with_source else ("gltf",)))


def read_cloud_bundle(stream: ByteReader) -> Capture:
    """Read a capture of `write_bundle`.

    Raises:
        FormatError: the file is no such bundle, or of another version.
        InputError: the content cannot be used.
    """
    capture = _read(stream, Capture)
    validate_cloud(capture.cloud)
    if capture.mesh is not None:
        _checked(capture.mesh)
    return capture


def _checked(mesh: TriangleMesh) -> TriangleMesh:
    if mesh.gltf is not None and (mesh.gltf.primitives[:, 2:].sum(axis=1) > mesh.num_vertices).any():
        raise FormatError("the bundle's glTF source names vertices that its mesh does not have")
    return validate_mesh(mesh)


def _read(stream: ByteReader, kind: type[Value], *, leave_out: tuple[str, ...] = ()) -> Value:
    try:
        tensors = load(read_all(stream, MAX_BYTES[kind]))
        content = json.loads(tensors[_FIELDS].tobytes())
        version = content["version"]
        if version == VERSION:
            stored = {name: part for name, part in content[kind.__name__].items() if name not in leave_out}
            # every field is checked by its type, arrays by dtype and number of axes
            checker = TypeAdapter(list[kind], config=ConfigDict(arbitrary_types_allowed=True))  # type: ignore[valid-type]
            (value,) = checker.validate_python([_restored(stored, tensors)])
            return value
    except (SafetensorError, KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise FormatError(f"the file is no bundle of a {kind.__name__}: {str(error)[:200]}") from error
    raise FormatError(f"the bundle is of version {str(version)[:20]}; this reader knows {VERSION}")


def _restored(part: Any, tensors: Tensors) -> Any:
    if isinstance(part, list):
        return [_restored(each, tensors) for each in part]
    if not isinstance(part, dict):
        return part
    if part.keys() == {_TENSOR}:
        return tensors[part[_TENSOR]]
    if part.keys() == {_BYTES}:
        return tensors[part[_BYTES]].tobytes()
    return {name: _restored(below, tensors) for name, below in part.items()}
